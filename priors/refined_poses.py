"""Refined poses: kept beside the cache's priors, and found again by the drive that they were made for.

    cache/<drive>/poses-<key>/poses.txt     a frame a line: id, and T_world_cam, row-major (3, 4), metres
                             /poses.json    what made them: drive, fingerprint, source, frames left out, what was found

poses.json is written last and marks both as done.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from eval.files import write_bytes
from priors.errors import DataError, unreadable
from priors.keys import key_of
from priors.poses import by_id, parse_pose, read_pose_lines
from priors.types import Matrix

FORMAT = 1
VERSION = 1
"""Raised when refined poses change."""
RECORD, POSES, PREFIX = "poses.json", "poses.txt", "poses-"


@dataclass(frozen=True)
class RefinedPoses:
    """Poses of a drive's frames, and what made them."""

    folder: Path
    record: Mapping[str, Any]
    """See `Recipe.record`; `found` is what came of it."""
    T_world_cam: Mapping[str, Matrix]
    """Frame id -> (4, 4), metres."""
    digest: str
    """Hash of the poses."""

    @property
    def fingerprint(self) -> str:
        """The drive's, with the poses that were refined."""
        return str(self.record["fingerprint"])

    def looked_at(self, ids: Collection[str]) -> list[str]:
        """Return which of these frames' own images or sweeps took part."""
        left_out = set(self.record["left_out"])
        return [id_ for id_ in ids if id_ in self.T_world_cam and id_ not in left_out]


@dataclass(frozen=True)
class Recipe:
    """What decides refined poses."""

    drive: Mapping[str, Any]
    """What reopens the drive, with its own poses."""
    fingerprint: str
    ids: Sequence[str]
    """Frames that get a pose."""
    left_out: Sequence[str]
    """Frames whose images and sweeps take no part."""
    source: str
    """stereo or lidar."""

    def folder(self, drive_folder: Path) -> Path:
        """Return where in a drive's folder of the cache such poses lie."""
        decides = {"version": VERSION, "fingerprint": self.fingerprint, "ids": list(self.ids)}
        decides |= {"left_out": list(self.left_out), "source": self.source}
        return drive_folder / f"{PREFIX}{key_of(decides)}"

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "fingerprint": self.fingerprint,
            "drive": dict(self.drive),
            "source": self.source,
            "left_out": list(self.left_out),
        }


def write(folder: Path, recipe: Recipe, poses: Sequence[Matrix], found: Mapping[str, Any]) -> None:
    """Write poses, one for each of the recipe's frames, and what was found on the way."""
    lines = [
        f"{id_} {' '.join(repr(float(x)) for x in T[:3].ravel())}" for id_, T in zip(recipe.ids, poses, strict=True)
    ]
    write_bytes(folder / POSES, ("\n".join(lines) + "\n").encode())
    write_bytes(folder / RECORD, (json.dumps({**recipe.record(), "found": dict(found)}, indent=2) + "\n").encode())


def load(folder: Path) -> RefinedPoses:
    """Read a folder of refined poses.

    Raises:
        DataError: there are none, or they are damaged.
    """
    path, again = folder / RECORD, "run `priors poses` again"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format"] != FORMAT:
            raise DataError(f"{path}: refined poses of format {record['format']}, expected {FORMAT}: {again}")
        drive, _, _ = dict(record["drive"]), str(record["fingerprint"]), list(record["left_out"])
        content = (folder / POSES).read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{error.filename}: no such file: `priors poses DATA` makes refined poses") from error
    except OSError as error:
        raise unreadable(error.filename, error) from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: damaged ({error}): {again}") from error
    lines = read_pose_lines(folder / POSES)
    named = by_id(lines, [line.words[0] for line in lines if line.words], folder / POSES)
    if named is None or not named:
        raise DataError(f"{folder / POSES}: expected a line a frame, an id and 12 numbers: {again}")
    poses = {id_: parse_pose(line.text, f"{folder / POSES}:{line.number}") for id_, line in named.items()}
    return RefinedPoses(folder, {**record, "drive": drive}, poses, sha256(content).hexdigest())


def find(place: Path, drive: str, fingerprint: str) -> RefinedPoses:
    """Return the refined poses of a drive: those in a folder of their own, or the only ones for it in a cache.

    Args:
        place: a folder of refined poses, or a cache.
        drive: the drive's name.
        fingerprint: of the drive with the poses that were refined.

    Raises:
        DataError: there are none of this drive, or several.
    """
    if (place / RECORD).exists():
        poses = load(place)
        if poses.fingerprint != fingerprint:
            other = poses.record["drive"].get("path")
            raise DataError(f"{place}: poses of {other}, not of this {drive}: run `priors poses` on it")
        return poses
    home = place / drive
    folders = sorted(path.parent for path in home.glob(PREFIX + "*/" + RECORD))
    fitting = [poses for poses in map(load, folders) if poses.fingerprint == fingerprint]
    if not fitting:
        raise DataError(f"{home}: no refined poses of this drive: make them by `priors poses`")
    if len(fitting) > 1:
        names = ", ".join(str(poses.folder) for poses in fitting)
        raise DataError(f"{home}: several refined poses of this drive: name one by --poses-from: {names}")
    return fitting[0]


def summarise(before_px: Matrix, after_px: Matrix, seen: int) -> dict[str, Any]:
    """Return what refining found, as JSON holds it."""
    before, after = (np.round(px, 4).tolist() for px in (before_px, after_px))
    return {"seen": seen, "residual_before_px": before, "residual_after_px": after}
