"""The journal of a prior, frames.jsonl: one JSON object a line, appended by any number of writers at once.

    {"id": "0000000005", "seconds": 0.041, "density": 0.93, ..., "maps": {...}, "made_of": {...}}      a record
    {"id": "0000000005", "damaged": "depth/0000000005.png: not what was written"}                      a mark

A record says what was computed. A mark says that a reader found a map damaged after that. Of each, the newest counts;
a record is newer than the marks before it. Lines that are none of the two are left out.
"""

import fcntl
import json
import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Line = dict[str, Any]


@dataclass(frozen=True)
class Entry:
    """What the journal says of a frame."""

    record: Line | None = None
    """The newest line of a computed frame; None where another tool made the map."""
    damaged: str | None = None
    """What a reader found wrong with its maps since then."""


class Journal:
    """Reads what was appended since it was last asked; any thread may ask."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._entries: dict[str, Entry] = {}
        self._read_to = 0
        self._file: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def entries(self) -> Mapping[str, Entry]:
        """Return what there is by frame id; nothing where the file is not there or cannot be read."""
        with self._lock:
            try:
                self._read_on()
            except OSError:
                return {}
            return self._entries

    def entry(self, frame_id: str) -> Entry:
        """Return what there is of one frame."""
        return self.entries().get(frame_id, Entry())

    def append(self, line: Line) -> None:
        """Add a line, whole or not at all.

        Raises:
            OSError: it cannot be written; the error names the file.
        """
        text = (json.dumps(line) + "\n").encode()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            try:
                _append(handle, text)
            finally:
                os.close(handle)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from error

    def _read_on(self) -> None:
        """Take in the whole lines that were appended; a file that was replaced is read from its start."""
        status = self.path.stat()  # cheaper than to open it, for each frame of a plan
        if (status.st_dev, status.st_ino, status.st_size) == (*(self._file or (0, 0)), self._read_to):
            return
        with self.path.open("rb") as file:
            status = os.fstat(file.fileno())
            if (status.st_dev, status.st_ino) != self._file or status.st_size < self._read_to:
                self._file, self._read_to, self._entries = (status.st_dev, status.st_ino), 0, {}
            if status.st_size == self._read_to:
                return
            file.seek(self._read_to)
            data = file.read()
        end = data.rfind(b"\n") + 1
        entries = dict(self._entries)  # others may be walking through the old ones
        for text in data[:end].splitlines():
            _take_in(text, entries)
        if _take_in(data[end:], entries):  # another tool's last line, without an end
            end = len(data)
        self._entries, self._read_to = entries, self._read_to + end


def _take_in(text: bytes, entries: dict[str, Entry]) -> bool:
    """Note what a line says; returns whether it is one of the two kinds."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):  # cut off by a kill, or not ours
        return False
    if not isinstance(line, dict) or not isinstance(line.get("id"), str):
        return False
    id_, damaged = line["id"], line.get("damaged")
    before = entries.get(id_, Entry())
    entries[id_] = Entry(line) if damaged is None else Entry(before.record, str(damaged))
    return True


def _append(handle: int, text: bytes) -> None:
    """Write at the end of an open file; a line that a kill cut off gets its end first, or it would swallow this one."""
    with suppress(OSError):  # file systems without locks: O_APPEND alone keeps lines apart
        fcntl.flock(handle, fcntl.LOCK_EX)
    size = os.fstat(handle).st_size
    if size and os.pread(handle, 1, size - 1) != b"\n":
        text = b"\n" + text
    try:
        written = os.write(handle, text)
        if written < len(text):
            os.write(handle, text[written:])  # raises the reason on a full disk
    except OSError:
        with suppress(OSError):
            os.ftruncate(handle, size)
        raise
