"""Sequences by name: which drive, which of its frames and which camera a published study took.

study-1 to study-8 are those of "Digging into Depth Priors for Outdoor Neural Radiance Fields" (Wang et al., ACM
Multimedia 2023), supplement B.1: five stretches of KITTI and three logs of Argoverse 1. The names of its folders
(s657_e787) say first and last frame, so both are taken here; its paper counts six frames fewer in each of KITTI's
stretches and does not say which. KITTI's raw drives and its odometry sequences hold the same frames under the same
numbers; the study took the odometry sequences' poses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from priors.errors import DataError
from priors.places import Place, places
from priors.types import Drive


@dataclass(frozen=True)
class Sequence:
    """A stretch of a drive."""

    drives: Mapping[str, str]
    """The drive's name in each data set that has it; the first is what a download is told to be."""
    cameras: Mapping[str, tuple[str, ...]]
    """The camera in each data set, by the data set's own name; the first that a drive has."""
    frames: tuple[int, int] | None
    """First and last frame; None: all of them."""
    hz: float
    """Frames a second."""
    get: str
    """Where its data is to be had."""

    @property
    def range(self) -> str | None:
        """The frames as a range a:b, as --frames takes it; None: all."""
        return None if self.frames is None else f"{self.frames[0]}:{self.frames[1] + 1}"


def _kitti(drive: str, odometry: str, first: int, last: int) -> Sequence:
    """Return a stretch of a KITTI drive."""
    drives = {"kitti_raw": f"{drive}_sync", "kitti_odometry": odometry}
    cameras = {"kitti_raw": ("image_02",), "kitti_odometry": ("image_2",)}
    get = f"KITTI raw's {drive} (synced+rectified), or odometry's sequence {odometry} in colour"
    return Sequence(drives, cameras, (first, last), 10.0, get)


def _argoverse(log: str) -> Sequence:
    """Return a whole log of Argoverse 1, as its stereo pair saw it."""
    cameras = {"argoverse1": ("stereo_front_left", "stereo_front_left_rect")}
    return Sequence({"argoverse1": log}, cameras, None, 5.0, f"Argoverse 1's tracking log {log}")


SEQUENCES: Mapping[str, Sequence] = {
    "study-1": _kitti("2011_10_03_drive_0027", "00", 657, 787),
    "study-2": _kitti("2011_10_03_drive_0027", "00", 890, 1028),
    "study-3": _kitti("2011_10_03_drive_0027", "00", 2700, 3000),
    "study-4": _kitti("2011_10_03_drive_0034", "02", 2749, 2929),
    "study-5": _kitti("2011_09_30_drive_0018", "05", 400, 725),
    "study-6": _argoverse("2c07fcda-6671-3ac0-ac23-4a232e0e031e"),
    "study-7": _argoverse("70d2aea5-dbeb-333d-b21e-76a7f2f1ba1c"),
    "study-8": _argoverse("cb0cba51-dfaf-34e9-a0c2-d931404c3dd8"),
}


@dataclass(frozen=True)
class Found:
    """Where a sequence's drive is."""

    place: Place
    camera: str
    """The camera to open it with."""


def find(name: str, folder: Path, dataset: str = "auto") -> Found:
    """Find a sequence's drive in a folder or at most three folders down.

    Args:
        name: of the sequence.
        folder: the drive's own, or one above it.
        dataset: only a drive of this data set counts; auto: any.

    Raises:
        DataError: it is not there, or lacks the camera; the missing folder is named.
    """
    sequence = SEQUENCES[name]
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder: --sequence {name} needs {sequence.get}")
    for known, drive in sequence.drives.items():
        for place in places(folder, drive) if dataset in ("auto", known) else []:
            if place.dataset == known:
                return Found(place, _camera(name, place))
    wanted = folder / next(iter(sequence.drives.values()))
    raise DataError(f"{wanted}: no such folder, nor 3 folders down: --sequence {name} needs {sequence.get}")


def expect_whole(name: str, drive: Drive) -> None:
    """Raise DataError, with the first file that is missing, unless a drive has all frames of a sequence."""
    sequence = SEQUENCES[name]
    if sequence.frames is None:
        return
    there = {int(id_) for id_ in drive.ids if id_.isdecimal()}
    first, last = sequence.frames
    missing = [number for number in range(first, last + 1) if number not in there]
    if missing:
        count = f"{len(missing)} of its {last + 1 - first} frames are missing"
        raise DataError(f"{_file(drive, missing[0])}: no such file: --sequence {name}: {count}: get {sequence.get}")


def _camera(name: str, place: Place) -> str:
    """Return the camera of a sequence that a drive has."""
    cameras = SEQUENCES[name].cameras[place.dataset]
    for camera in cameras:
        if (place.path / camera).exists():
            return camera
    raise DataError(f"{place.path / cameras[0]}: no such folder: --sequence {name} needs {SEQUENCES[name].get}")


def _file(drive: Drive, number: int) -> str:
    """Return where the image of a frame that is missing would be."""
    images = getattr(drive, "images", {})
    some: Path | None = next(iter(images.values()), None)
    if some is None:
        return f"{drive.name}: frame {number}"
    return str(some.with_name(f"{number:0{len(some.stem)}d}{some.suffix}"))
