"""What was learned from a drive before its first map: the files of any frame that were read for it.

A method may look at the whole drive first: our single-image network adapts to it, and aligns to it. One list of what
it read serves all maps that are made with it:

    learned/<name>.json     {"0000000005": {"image": {...}, "sweep 0": {...}}, ...}     calls and files as in sources.py

A map's record names the list, "made_of": {"drive": {"file": "<name>.json"}}. The name is a digest of what the files
held.
"""

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from priors.cache.sources import Call, Digests, Sources, record_calls, watch, why_stale
from priors.cache.store import publish
from priors.drive_around import DriveAround
from priors.errors import DataError
from priors.types import Drive, Frame

FOLDER, ENTRY = "learned", "drive"
DriveSources = dict[str, Sources]
"""Frame id -> the files that were read of it."""


class WatchedDrive(DriveAround):
    """A drive that notes what is read of its frames."""

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self._calls: dict[str, dict[str, Call]] = {}
        self._before: DriveSources = {}

    def frame(self, index: int) -> Frame:
        """Return a frame whose readers are watched."""
        frame = self.drive[index]
        return watch(frame, self._calls.setdefault(frame.id, {})).frame

    def learned_before(self, sources: DriveSources) -> None:
        """Count files that were read when what is used now was learned."""
        self._before = sources

    def sources(self, digests: Digests) -> DriveSources:
        """Return what was read so far, by frame."""
        read = {frame_id: record_calls(calls, digests) for frame_id, calls in self._calls.items() if calls}
        return {id_: self._before.get(id_, {}) | read.get(id_, {}) for id_ in sorted(self._before.keys() | read.keys())}


def keep(folder: Path, sources: DriveSources) -> dict[str, Any] | None:
    """Write the list of what was learned from into a prior's folder; returns what names it, None for an empty list."""
    if not sources:
        return None
    content = {id_: {call: _content(file) for call, file in calls.items()} for id_, calls in sources.items()}
    name = f"{hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()}.json"
    write_bytes(folder / FOLDER / name, (json.dumps(sources, indent=1) + "\n").encode())
    publish(folder / FOLDER / name)
    return {"file": name}


def why_learned_stale(sources: Any, drive: Drive, digests: Digests) -> str | None:
    """Say which file is not what was learned from; None where all are, or nothing is known."""
    places = {id_: index for index, id_ in enumerate(drive.ids)}
    for id_, calls in sources.items() if isinstance(sources, dict) else []:
        if id_ not in places:
            return f"frame {id_} is gone"
        try:
            reason = why_stale(calls, drive[places[id_]], digests)
        except DataError as error:
            reason = str(error)
        if reason is not None:
            return f"frame {id_}: {reason}"
    return None


class Freshness:
    """Tells of a prior's maps whether the drive still holds what they were made of; each list is compared once."""

    def __init__(self, folder: Path, drive: Drive, digests: Digests) -> None:
        self.folder, self.drive, self.digests = folder / FOLDER, drive, digests
        self._reasons: dict[str, str | None] = {}

    def why_stale(self, sources: Any, frame: Frame) -> str | None:
        """Say which file is not what a map was made of, or its method learned from; None where all are, or unknown.

        Args:
            sources: of the map's record, whatever it holds.
            frame: the frame of today.
        """
        return why_stale(sources, frame, self.digests) or self._why_learned_stale(sources)

    def _why_learned_stale(self, sources: Any) -> str | None:
        named = sources.get(ENTRY) if isinstance(sources, dict) else None
        name = named.get("file") if isinstance(named, dict) else None
        if not isinstance(name, str) or Path(name).name != name:
            return None
        if name not in self._reasons:
            self._reasons[name] = self._compare(name)
        return self._reasons[name]

    def _compare(self, name: str) -> str | None:
        with suppress(OSError, ValueError, RecursionError):  # a list that is lost: nothing is known
            reason = why_learned_stale(json.loads((self.folder / name).read_bytes()), self.drive, self.digests)
            return None if reason is None else f"learned from the drive: {reason}"
        return None


def _content(file: Any) -> Any:
    return (file.get("sha256"), file.get("bytes")) if isinstance(file, dict) else None
