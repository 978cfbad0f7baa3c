"""What a map was made of: the files that were read, or looked for in vain, while it was computed.

A watched frame notes each call of its readers, and each reader that was asked for and is not there:

    "image": {"file": "0000000005.png", "bytes": 801234, "modified_ns": 1321012345000000000, "sha256": "9f86d0..."}
    "sweep -5": null                                    the sweep five frames before: the drive has no such file
    "sweep.times": {...}                                another file that all calls of "sweep" read
    "other": null                                       the frame has no reader of that name

A map is stale when one of these calls now means a file of another content, or is answered where it was not. Names are
for people: a file that was moved, copied or renamed is the same. Equal size and time spare the reading.
"""

import hashlib
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from priors.types import Frame

Sources = dict[str, dict[str, Any] | None]
"""Call -> the file that it read, as the journal keeps it; None where there was none."""
Stamp = tuple[int, int]
"""Size in bytes, and time of the last change in ns."""
Call = tuple[Path | None, Stamp | None]
"""The file of a call, and the file's stamp before it was read."""


class Digests:
    """SHA-256 of files, each read once: neighbouring frames share sweeps. Any thread may ask."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, Stamp], str] = {}
        self._reading: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def of(self, path: Path, stamp: Stamp) -> str | None:
        """Return the digest of a file as it was at a stamp; None where it has changed since, or cannot be read."""
        with self._lock:
            reading = self._reading.setdefault(str(path), threading.Lock())
        with reading:
            if (str(path), stamp) not in self._known:
                try:
                    with path.open("rb") as file:
                        digest = hashlib.file_digest(file, "sha256").hexdigest()
                except OSError:
                    return None
                if stamp_of(path) != stamp:
                    return None
                self._known[str(path), stamp] = digest
            return self._known[str(path), stamp]


@dataclass(frozen=True)
class Watch:
    """Notes what is read of a frame."""

    frame: Frame
    """To be computed with in place of the one that was given."""
    calls: dict[str, Call] = field(default_factory=dict)

    def sources(self, digests: Digests) -> Sources:
        """Return what was read so far, as the journal keeps it."""
        return record_calls(self.calls, digests)


class _Readers(Mapping[str, Callable[..., Any]]):
    """A frame's readers that note their calls."""

    def __init__(self, frame: Frame, calls: dict[str, Call]) -> None:
        self.frame, self.calls = frame, calls

    def __getitem__(self, what: str) -> Callable[..., Any]:
        return partial(self._read, what, self.frame.readers[what])

    def __iter__(self) -> Iterator[str]:
        return iter(self.frame.readers)

    def __len__(self) -> int:
        return len(self.frame.readers)

    def __contains__(self, what: object) -> bool:
        if what in self.frame.readers:
            return True
        self.calls.setdefault(str(what), (None, None))  # a map may depend on what is not there
        return False

    def _read(self, what: str, reader: Callable[..., Any], *args: Any) -> Any:
        self._note(" ".join([what, *map(str, args)]), what, *args)
        for beside in self.frame.files:
            if beside.startswith(f"{what}."):
                self._note(beside, beside)
        return reader(*args)

    def _note(self, call: str, what: str, *args: Any) -> None:
        """Note which file a call reads, as it is before that."""
        if call not in self.calls and what in self.frame.files:
            path = self.frame.files[what](*args)
            self.calls[call] = path, None if path is None else stamp_of(path)


def record_calls(calls: Mapping[str, Call], digests: Digests) -> Sources:
    """Return calls as the journal keeps them."""
    return {call: _record(path, stamp, digests) for call, (path, stamp) in dict(calls).items()}


def watch(frame: Frame, calls: dict[str, Call] | None = None) -> Watch:
    """Return a frame that is as the given one, and what notes what is read of it, to `calls` where they are given."""
    calls = {} if calls is None else calls
    return Watch(replace(frame, readers=_Readers(frame, calls)), calls)


def why_stale(sources: Any, frame: Frame, digests: Digests) -> str | None:
    """Say which file is not what a map was made of; None where all are, or nothing is known.

    Args:
        sources: of the map's record, whatever it holds.
        frame: the frame of today.
        digests: reads files whose size or time has changed.
    """
    for call, before, path in _today(sources, frame):
        if reason := _difference(before, path, digests):
            return f"{call}: {reason}"
    return None


def restamped(sources: Any, frame: Frame) -> Sources | None:
    """Return the sources of a map that is not stale with the size and time of today's files; None where all are so.

    Files that were copied have another time. Once it is known, they need not be read again.
    """
    changed = {}
    for call, before, path in _today(sources, frame):
        stamp = None if path is None else stamp_of(path)
        if stamp is not None and isinstance(before, dict) and before.get("modified_ns") != stamp[1]:
            changed[call] = {**before, "modified_ns": stamp[1]}
    return {**sources, **changed} if changed else None


def _today(sources: Any, frame: Frame) -> Iterator[tuple[str, Any, Path | None]]:
    """Give each call of a record, what it says of the file, and today's file; calls that the frame cannot tell not."""
    for call, before in sources.items() if isinstance(sources, dict) else []:
        what, *words = call.split(" ")
        if what in frame.files:
            yield call, before, frame.files[what](*map(_number, words))


def stamp_of(path: Path) -> Stamp | None:
    """Return a file's size and time; None where it cannot be asked."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def _record(path: Path | None, stamp: Stamp | None, digests: Digests) -> dict[str, Any] | None:
    if path is None:
        return None
    if stamp is None:
        return {"file": path.name}
    size, modified_ns = stamp
    return {"file": path.name, "bytes": size, "modified_ns": modified_ns, "sha256": digests.of(path, stamp)}


def _difference(before: Any, path: Path | None, digests: Digests) -> str | None:
    """Say how a file differs from a record; None where it does not."""
    if path is None:
        return None if before is None else f"{before.get('file', 'its file')} is gone"
    if not isinstance(before, dict):
        return f"{path.name} was not there"
    stamp = stamp_of(path)
    if stamp is None:
        return None if "bytes" not in before else f"{path.name} cannot be read"
    if stamp == (before.get("bytes"), before.get("modified_ns")):
        return None
    same = stamp[0] == before.get("bytes") and before.get("sha256") == digests.of(path, stamp)
    return None if same and before.get("sha256") is not None else f"{path.name} has changed"


def _number(word: str) -> Any:
    with suppress(ValueError):
        return int(word)
    return word
