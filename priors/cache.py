"""The cache: depth maps in files that a stranger can read and write (docs/cache.md).

    cache/<drive>/<method>-<key>/manifest.json          what made it
                                /depth/<id>.png         uint16, metres x 256, rounded, 0 = no value
                                /confidence/<id>.png    uint16, confidence x 65535 (8 bits are read too)
                                /frames.jsonl           one line a computed frame: seconds, density, range

The key (priors/keys.py) is a hash of everything that decides what the maps hold, so a changed parameter is another
folder and never an old map. A depth file is the mark that its frame is done: it is renamed into place last.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval import files
from eval.files import write_bytes
from priors import codecs
from priors.errors import DataError
from priors.frame_ids import in_order
from priors.types import Depth

FORMAT = 1
FIRST_VERSION = 1
"""Of every method, in manifests of the time when the package's version stood for it."""
_PNG_END = b"IEND\xaeB`\x82"


@dataclass(frozen=True)
class Prior:
    """One method with one config applied to one drive: a folder of the cache.

    Where an earlier version made it, the manifest's config may have fields' earlier names (priors/records.py).
    """

    folder: Path
    manifest: dict[str, Any]

    @property
    def name(self) -> str:
        """Folder name, <method>-<key>."""
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

    def depth_path(self, frame_id: str) -> Path:
        """Return where a frame's depth is, or will be."""
        return self.folder / "depth" / f"{frame_id}.png"

    def confidence_path(self, frame_id: str) -> Path:
        """Return where a frame's confidence is, or will be."""
        return self.folder / "confidence" / f"{frame_id}.png"

    def ids(self) -> list[str]:
        """List the frames that are done."""
        return in_order(path.stem for path in (self.folder / "depth").glob("[!.]*.png"))

    def has(self, frame_id: str) -> bool:
        """Tell whether a frame is done: its files are there and whole."""
        depth, confidence = self.depth_path(frame_id), self.confidence_path(frame_id)
        return _is_whole(depth) and (not confidence.parent.is_dir() or _is_whole(confidence))

    def read(self, frame_id: str) -> Depth:
        """Read a frame's map; DataError where it is missing or half written."""
        depth, confidence = self.depth_path(frame_id), self.confidence_path(frame_id)
        try:
            depth_m = codecs.read_depth_png(depth)
            if not confidence.parent.is_dir():
                return Depth(depth_m)
            return Depth(depth_m, codecs.read_confidence_png(confidence))
        except DataError as error:
            raise DataError(f"{error} (half-written cache: run the same `priors build` again)") from error

    def write(self, frame_id: str, depth: Depth, seconds: float) -> dict[str, Any]:
        """Write a frame's map; returns its line of frames.jsonl.

        Values above 255.99 m cannot be held: they become "no value" and are counted in `too_far`.
        """
        if depth.confidence is not None:
            codecs.write_confidence_png(self.confidence_path(frame_id), depth.confidence)
        too_far = codecs.write_depth_png(self.depth_path(frame_id), depth.depth_m)
        line = {"id": frame_id, "seconds": round(seconds, 4), **describe(depth), "too_far": too_far}
        with (self.folder / "frames.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        return line

    def drop_stale(self) -> None:
        """Delete temporary files that a kill left behind, once no other machine can still be writing them."""
        files.drop_stale(self.folder)

    def lines(self) -> dict[str, dict[str, Any]]:
        """Return frames.jsonl by frame id: the newest line of each; a line cut off by a kill is left out."""
        path = self.folder / "frames.jsonl"
        found = {}
        for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
            try:
                line = json.loads(text)
                found[line["id"]] = line
            except (ValueError, KeyError, TypeError):
                continue
        return found


def describe(depth: Depth) -> dict[str, float | None]:
    """Return density and the smallest, median and largest depth (metres; None where nothing has a value)."""
    values = depth.depth_m[depth.valid]
    if not values.size:
        return {"density": 0.0, "min_m": None, "median_m": None, "max_m": None}
    low, middle, high = (round(float(v), 3) for v in (values.min(), np.median(values), values.max()))
    return {"density": round(depth.density, 5), "min_m": low, "median_m": middle, "max_m": high}


def create(folder: Path, manifest: dict[str, Any]) -> Prior:
    """Open the prior of a folder, making it where there is none, and write its manifest.

    An existing manifest of another format is refused; any other is rewritten: a drive may have moved, or fields may
    have been renamed since.
    """
    path = folder / "manifest.json"
    if path.exists():
        load(folder)
    write_bytes(path, (json.dumps(manifest, indent=2, allow_nan=False) + "\n").encode())
    return Prior(folder, manifest)


def load(folder: Path) -> Prior:
    """Open a prior's folder; DataError where its manifest is missing, damaged or of another format."""
    path = folder / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        found = manifest["format"]
        manifest["method"], manifest["drive"]["name"], manifest["key"]
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file: not a prior's folder, or half written; build it again") from error
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise DataError(f"{path}: damaged manifest: delete {folder} and build it again") from error
    if found != FORMAT:
        raise DataError(f"{path}: cache format {found}, this version reads {FORMAT}: delete {folder}, build it again")
    return Prior(folder, {"version": FIRST_VERSION, **manifest})


def find(path: Path) -> list[Prior]:
    """Return the priors at path: a prior's own folder, a drive's, or the whole cache."""
    if not path.is_dir():
        raise DataError(f"{path}: no such folder: build a prior first (`priors build DATA --method stereo`)")
    priors = [load(folder) for folder in _folders(path)]
    if not priors:
        raise DataError(f"{path}: no priors in it: build one first (`priors build DATA --method stereo`)")
    return priors


def only(path: Path) -> Prior:
    """Return the one prior at path; DataError where there are several."""
    found = find(path)
    if len(found) > 1:
        raise DataError(f"{path}: holds {len(found)} priors: name one, for example {found[0].folder}")
    return found[0]


def _folders(path: Path) -> Iterator[Path]:
    """Yield prior folders: those with a manifest, and those that have maps but lost it."""
    for pattern in (".", "*", "*/*"):
        for folder in [path] if pattern == "." else sorted(path.glob(pattern)):
            if (folder / "manifest.json").exists() or (folder / "depth").is_dir():
                yield folder


def _is_whole(path: Path) -> bool:
    """Tell by its last bytes whether a PNG was written to its end (a power cut can leave a renamed, empty file)."""
    try:
        with path.open("rb") as file:
            file.seek(-len(_PNG_END), 2)
            return file.read() == _PNG_END
    except OSError:
        return False
