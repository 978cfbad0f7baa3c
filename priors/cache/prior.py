"""A prior: the depth maps that one method with one config made of one drive, in a folder of the cache.

What is read is verified: a map that is not what was written is an error, and the journal is told, so that the next
build makes it anew. A cache that cannot be written is as good to read.
"""

import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from eval import files
from eval.files import replacing, write_bytes
from priors import codecs
from priors.cache import manifest as manifests
from priors.cache.journal import Entry, Journal, Line
from priors.cache.sources import Sources
from priors.cache.store import Store, publish, store_of
from priors.errors import DataError
from priors.frame_ids import in_order
from priors.types import Depth, FloatMap

CONFIDENCES = ("confidence", "consistency", "confidence_relative")
"""Maps that may stand beside the depth, coded alike, each in a folder of its name: the fields of a Depth, in order."""
MEND = "run the same `priors {}` again"
_PNG_END = b"IEND\xaeB`\x82"


class DamagedError(DataError):
    """A map that is there and is not what was written."""


@dataclass(frozen=True)
class Prior:
    """One method with one config applied to one drive: a folder of the cache.

    Where an earlier version made it, the manifest's config may have fields' earlier names (priors/records.py).
    """

    folder: Path
    manifest: dict[str, Any]

    @property
    def name(self) -> str:
        """Folder name, `<method>-<key>`."""
        return self.folder.name

    @property
    def method(self) -> str:
        """Method that made the maps."""
        return str(self.manifest["method"])

    @property
    def drive(self) -> dict[str, Any]:
        """What the manifest records of the drive."""
        record: dict[str, Any] = self.manifest["drive"]
        return record

    @cached_property
    def store(self) -> Store | None:
        """The object store that the folder is a mirror of; None: it is a folder of a disk."""
        return store_of(self.folder)

    @cached_property
    def _stored(self) -> set[str]:
        """The maps that lie in the store, by their names in the folder: depth/<id>.png."""
        if self.store is None:
            return set()
        own = self.folder.relative_to(self.store.folder).as_posix()
        return {name.removeprefix(f"{own}/") for name in self.store.names(own) if name.endswith(".png")}

    @cached_property
    def journal(self) -> Journal:
        """What was computed and what was found damaged."""
        return Journal(self.folder / "frames.jsonl")

    def depth_path(self, frame_id: str) -> Path:
        """Return where a frame's depth is, or will be."""
        return self.path("depth", frame_id)

    def confidence_path(self, frame_id: str) -> Path:
        """Return where a frame's confidence is, or will be."""
        return self.path("confidence", frame_id)

    def path(self, kind: str, frame_id: str) -> Path:
        """Return where a frame's map of a kind (depth, or one of CONFIDENCES) is, or will be."""
        return self.folder / kind / f"{frame_id}.png"

    def ids(self) -> list[str]:
        """List the frames that have a depth file."""
        stored = {name[6:-4] for name in self._stored if name.startswith("depth/")}
        try:
            with os.scandir(self.folder / "depth") as entries:
                return in_order({e.name[:-4] for e in entries if _is_map(e.name) and e.is_file()} | stored)
        except (FileNotFoundError, NotADirectoryError):
            return in_order(stored)

    def has(self, frame_id: str) -> bool:
        """Tell whether a frame is done: its files are there and whole, and nobody found them damaged."""
        return self.why_not_done(frame_id) is None

    def why_not_done(self, frame_id: str) -> str | None:
        """Say why a frame counts as not done, without reading its maps; None where it is done."""
        entry = self.journal.entry(frame_id)
        if entry.damaged is not None:
            return entry.damaged
        written = _written(entry)
        for kind in self._kinds(frame_id, entry):
            path = self.path(kind, frame_id)
            if not self._is_there(path, written.get(kind, {}).get("bytes")):
                return f"{kind}/{path.name}: " + ("half written" if path.exists() else "no such file")
        return None

    def read(self, frame_id: str) -> Depth:
        """Read a frame's maps and verify them.

        Raises:
            DamagedError: they are not what was written; the journal is told, where it can be.
            DataError: the frame has no map, or it cannot be read.
        """
        entry = self.journal.entry(frame_id)
        try:
            return self._read(frame_id, entry)
        except DamagedError as error:
            newer = self.journal.entry(frame_id)
            if newer.record != entry.record:  # a build has just made it anew
                return self.read(frame_id)
            if newer.damaged is None:
                with suppress(OSError):  # a cache of somebody else: the error alone tells
                    reason = str(error).removeprefix(f"{self.folder}{os.sep}").removesuffix(f": {self._mend}")
                    self.journal.append({"id": frame_id, "damaged": reason})
            raise

    def write(self, frame_id: str, depth: Depth, seconds: float, made_of: Sources | None = None) -> Line:
        """Write a frame's maps; returns its line of frames.jsonl.

        Values above 255.99 m cannot be held: they become "no value" and are counted in `too_far`. A kill leaves the
        frame without a depth file: as not done.

        Args:
            frame_id: the frame.
            depth: its map, and the confidences that the method gives.
            seconds: how long it took.
            made_of: the files that the map was made of; None where they are not known.
        """
        data, too_far = codecs.encode_depth_png(depth.depth_m)
        others = {kind: codecs.encode_confidence_png(part) for kind, part in _confidences(depth).items()}
        line: Line = {"id": frame_id, "seconds": round(seconds, 4), **describe(depth), "too_far": too_far}
        line["maps"] = {kind: _identity(part) for kind, part in {"depth": data, **others}.items()}
        if made_of is not None:
            line["made_of"] = made_of
        for kind in CONFIDENCES:
            if kind in others:
                write_bytes(self.path(kind, frame_id), others[kind])
            else:
                self.path(kind, frame_id).unlink(missing_ok=True)  # of an earlier map
        path = self.depth_path(frame_id)
        with replacing(path) as temporary:
            temporary.write_bytes(data)
            path.unlink(missing_ok=True)  # the new line must never stand beside an old map
            self.journal.append(line)
        self._publish(frame_id, line, list(others))
        return line

    def _publish(self, frame_id: str, line: Line, others: list[str]) -> None:
        """Put a frame's files into the store, where there is one, the depth last; they need not stay here."""
        if self.store is None:
            return
        paths = [self.path(kind, frame_id) for kind in others]
        try:
            for path in paths:
                self.store.put(path)
            self.store.add_line(self.folder, line)
            self.store.put(self.depth_path(frame_id))
            self._stored.update(f"{path.parent.name}/{path.name}" for path in [*paths, self.depth_path(frame_id)])
        finally:
            for path in [*paths, self.depth_path(frame_id)]:
                path.unlink(missing_ok=True)

    def drop_stale(self) -> None:
        """Delete temporary files that a kill left behind, once no other machine can still be writing them."""
        files.drop_stale(self.folder)

    def lines(self) -> dict[str, Line]:
        """Return the newest record of each frame by its id; frames that another tool made have none."""
        entries = self.journal.entries()
        return {id_: entry.record for id_, entry in entries.items() if entry.record is not None}

    def is_recorded(self, frame_id: str) -> bool:
        """Tell whether the checksum of a frame's depth is known, so that reading verifies it."""
        return "depth" in _written(self.journal.entry(frame_id))

    def figures(self, name: str, ids: Iterable[str] | None = None) -> list[float]:
        """Return a figure of the records (seconds, density, ...) of some frames; those without it are left out."""
        lines = self.lines()
        chosen = lines if ids is None else [id_ for id_ in ids if id_ in lines]
        values = [lines[id_].get(name) for id_ in chosen]
        return [float(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool) and np.isfinite(v)]

    def _kinds(self, frame_id: str, entry: Entry) -> list[str]:
        """List the kinds of maps that a frame must have, and those that it has besides."""
        written = _written(entry)
        kinds = ["depth"]
        if "confidence" in written if written else (self.folder / "confidence").is_dir():
            kinds.append("confidence")
        there = [k for k in CONFIDENCES if self.path(k, frame_id).exists() or f"{k}/{frame_id}.png" in self._stored]
        return kinds + [k for k in CONFIDENCES if k not in kinds and (k in written or k in there)]

    def _read(self, frame_id: str, entry: Entry) -> Depth:
        maps: dict[str, FloatMap] = {}
        for kind in self._kinds(frame_id, entry):
            path = self.path(kind, frame_id)
            try:
                data = self._bytes(path)
            except DataError as error:
                raise DataError(
                    f"{error} (half-written cache: {self._mend})" if not path.exists() else str(error)
                ) from error
            maps[kind] = self._decode(kind, data, path, _written(entry).get(kind))
        size = self._size() or maps["depth"].shape
        for kind, values in maps.items():
            if values.shape != size:
                found = " and ".join(map(str, (values.shape, size)))
                raise DamagedError(f"{self.path(kind, frame_id)}: sizes differ, {found}: {self._mend}")
        return Depth(maps["depth"], *map(maps.get, CONFIDENCES))

    def _is_there(self, path: Path, size: Any) -> bool:
        """Tell whether a map is there and whole, without reading it: in the store where there is one."""
        if self.store is not None:
            return f"{path.parent.name}/{path.name}" in self._stored
        return _is_whole(path, size)

    def _bytes(self, path: Path) -> bytes:
        """Read a file of the folder, or of the store where it is not here."""
        if self.store is not None and not path.exists() and f"{path.parent.name}/{path.name}" in self._stored:
            return self.store.get(path.relative_to(self.store.folder).as_posix())
        return codecs.read_bytes(path)

    def _decode(self, kind: str, data: bytes, path: Path, written: Line | None) -> FloatMap:
        """Return what a file holds; DamagedError where it is not what was written, or no map at all."""
        if written is not None and written.get("sha256") != hashlib.sha256(data).hexdigest():
            raise DamagedError(f"{path}: damaged: not the {written.get('bytes')} bytes that were written: {self._mend}")
        try:
            return codecs.decode_depth_png(data, path) if kind == "depth" else codecs.decode_confidence_png(data, path)
        except DataError as error:
            raise DamagedError(f"{error}: {self._mend}") from error

    @property
    def _mend(self) -> str:
        """Say which command makes the maps again."""
        return MEND.format("import" if self.method == "imported" else "build")

    def _size(self) -> tuple[int, ...] | None:
        """Return (height, width) of the maps, where the manifest says it and all have one size."""
        if self.drive.get("cameras") is not None:
            return None  # each frame's own (priors/drives/_camera_drive.py: BY_FRAME)
        size = self.manifest.get("camera", {}).get("size")
        whole = isinstance(size, list) and all(isinstance(length, int) for length in size)
        return tuple(size) if whole else None


def load(folder: Path) -> Prior:
    """Open a prior's folder.

    Raises:
        NewerFormatError: a later version wrote it.
        DataError: its manifest is missing or damaged.
    """
    return Prior(folder, manifests.read(folder))


def create(folder: Path, manifest: dict[str, Any]) -> Prior:
    """Open the prior of a folder, making it where there is none, and write its manifest.

    What is there is rewritten, since a drive may have moved or fields may have been renamed; a damaged one too.

    Raises:
        NewerFormatError: a later version's manifest is there.
        OSError: it cannot be written.
    """
    manifests.write(folder, manifest)
    publish(folder / manifests.NAME)
    return Prior(folder, manifest)


def describe(depth: Depth) -> dict[str, float | None]:
    """Return density and the smallest, median and largest depth (metres; None where nothing has a value)."""
    values = depth.depth_m[depth.valid]
    if not values.size:
        return {"density": 0.0, "min_m": None, "median_m": None, "max_m": None}
    low, middle, high = (round(float(v), 3) for v in (values.min(), np.median(values), values.max()))
    return {"density": round(depth.density, 5), "min_m": low, "median_m": middle, "max_m": high}


def _confidences(depth: Depth) -> dict[str, FloatMap]:
    """Return the confidences that a map has, by their kind."""
    parts = zip(CONFIDENCES, (depth.confidence, depth.consistency, depth.within_5_percent), strict=True)
    return {kind: part for kind, part in parts if part is not None}


def _identity(data: bytes) -> Line:
    """Return what tells a file's content."""
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def _written(entry: Entry) -> dict[str, Line]:
    """Return what a record says of the maps by their kind; nothing where it is not known, as before format 2."""
    maps = None if entry.record is None else entry.record.get("maps")
    if not isinstance(maps, dict):
        return {}
    return {kind: identity for kind, identity in maps.items() if isinstance(identity, dict)}


def _is_map(name: str) -> bool:
    return name.endswith(".png") and not name.startswith(".")


def _is_whole(path: Path, size: Any) -> bool:
    """Tell without reading it whether a PNG was written to its end, and has the size that is known (None: any).

    A power cut can leave a renamed, empty file.
    """
    try:
        with path.open("rb", buffering=0) as file:
            end = file.seek(-len(_PNG_END), os.SEEK_END)
            return size in (None, end + len(_PNG_END)) and file.read(len(_PNG_END)) == _PNG_END
    except OSError:
        return False
