"""Drives: one file per data set, and the folder is the registry.

A data set's file has two functions: `recognises(path)` and `open_drive(path, options)`. Adding the file adds the
`--dataset` choice; listing the choices imports none of them. Your own files: priors/extensions.py.

Where drives lie in folders of their own below the data set's (priors/places.py looks for them), the file also has
`is_drive(folder)`, and `BELOW`, the most levels between the two. One that has `LAST` is asked only where no other data
set knows a folder; one that has `TAKES_FX` reads --fx.
"""

import logging
import os
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from priors import extensions, refined_poses
from priors.drive_around import Stretch
from priors.drives._camera_drive import BY_FRAME as BY_FRAME
from priors.drives._camera_drive import CameraDrive as CameraDrive
from priors.drives._files import first_size as first_size
from priors.drives._files import stems as stems
from priors.drives._files import subfolders as subfolders
from priors.drives._links import plain
from priors.drives._refined import RefinedDrive as RefinedDrive
from priors.errors import DataError, UsageError, expect, expect_choices
from priors.types import Drive

__path__.extend(extensions.folders("drives"))
LOG = logging.getLogger(__name__)
CACHE = Path("cache")
"""Where commands keep results unless they are told."""
LISTED = 1000  # entries of an unknown folder that its error message looks at


@dataclass(frozen=True)
class DriveOptions:
    """What narrows a folder down to one camera of one drive."""

    drive: str | None = None
    """Drive, sequence or log to read where DATA holds several, e.g. 2011_09_26_drive_0001_sync or 06."""
    camera: str | None = None
    """Camera to make depth for, by the data set's own name (image_02, ring_front_center, ...); default: the first
    with a partner for stereo."""
    fx: float | None = None
    """Focal length of plain images, pixels; default: what their EXIF says. Other data sets have a calibration."""
    truth: Path | None = None
    """Folder with KITTI depth maps: holds train/DRIVE/proj_depth or DRIVE/proj_depth. For Argoverse 1: the folder
    that holds disparity_maps_v1.1. For KITTI stereo: disp_noc_0, say."""
    poses: Literal["auto", "recorded", "dead-reckoned", "refined"] = "auto"
    """Where poses come from: the positions as recorded; dead-reckoned from recorded velocities and tied to the
    positions over seconds; or refined by what images see (`priors poses`). auto: dead-reckoned where a drive records
    velocities (KITTI raw), else as recorded."""
    poses_from: Path = CACHE
    """Where --poses refined finds them: the cache that `priors poses` wrote to, or one folder of poses in it."""

    def __post_init__(self) -> None:
        expect_choices(self, "")
        beside = self.poses == "refined" or self.poses_from == CACHE
        expect(beside, "--poses-from", self.poses_from, "--poses refined beside it")
        expect(self.drive != "", "--drive", "''", "a name, or leave it out")
        expect(self.fx is None or 0 < self.fx < float("inf"), "--fx", self.fx, "pixels, more than 0")
        expect(self.camera != "", "--camera", "''", "a name, or leave it out")


def names() -> list[str]:
    """List the data sets, without importing their readers."""
    return extensions.names(__path__)


def open_drive(path: Path, dataset: str = "auto", options: DriveOptions | None = None) -> Drive:
    """Open the drive in a folder; 'auto' recognises the data set from the folder's content.

    Raises:
        DataError: the folder is missing, nothing recognises it, or it holds several drives and none is named.
    """
    path = Path(path)
    if ".." in path.parts or not path.name or path.parts[0].startswith("~"):
        path = plain(path)  # "." has no name, and nothing above it
    if not path.is_dir():
        raise DataError(f"{path}: " + ("is a file: name the drive's folder" if path.exists() else "no such folder"))
    name = _recognise(path) if dataset == "auto" else dataset
    options, chosen = options or DriveOptions(), reader(name)
    if options.fx is not None and not getattr(chosen, "TAKES_FX", False):
        raise UsageError(f"--fx {options.fx:g}: {name} has its own calibration: leave it out")
    drive: Drive = chosen.open_drive(path, options)
    LOG.info("%s: %s, %d frames, read as %s", path, drive.name, len(drive.ids), name)
    if options.poses == "dead-reckoned" and poses_of(drive.describe()) != options.poses:
        raise UsageError(f"--poses dead-reckoned: {drive.name} has no velocities that fit its positions: leave it out")
    return _refined(drive, options) if options.poses == "refined" else drive


def _refined(drive: Drive, options: DriveOptions) -> RefinedDrive:
    """Place a drive by its refined poses; DataError where there are none, or several."""
    return RefinedDrive(drive, refined_poses.find(options.poses_from, drive.name, drive.fingerprint()))


def poses_of(description: dict[str, Any]) -> str:
    """Return which poses a drive has, by its description: as they are recorded, unless it says more."""
    return str(description.get("poses", "recorded"))


def truth_of(description: dict[str, Any]) -> str | None:
    """Return which truth a drive has, by its description, where the data set has several; None: it has one kind."""
    named = description.get("truth_maps")
    return None if named is None else str(named)


def is_by_frame(description: dict[str, Any]) -> bool:
    """Tell whether a drive's frames have cameras of their own, by its description: then one says nothing of others."""
    return description.get("cameras") == BY_FRAME


def poses_remark(drive: Drive, held_out: Collection[str]) -> tuple[str, ...]:
    """Say of refined poses whether images or sweeps of held-out frames took part; nothing of other poses."""
    if isinstance(drive, Stretch):
        return poses_remark(drive.drive, held_out)
    if not isinstance(drive, RefinedDrive):
        return ()
    seen, source = len(drive.poses.looked_at(held_out)), drive.poses.record["source"]
    return (f"poses refined by {source}: {seen or 'none'} of the {len(held_out)} held-out views took part in it",)


def reopen(description: dict[str, Any], moved_to: Path | None = None) -> Drive:
    """Open the drive that a manifest describes: what its `describe()` returned.

    Args:
        description: of the drive.
        moved_to: where it is now. Whether it is the same drive is for the caller to ask, by its fingerprint.

    Raises:
        DataError: the description is damaged, or the drive is not there.
    """
    try:
        path, dataset = moved_to or Path(description["path"]), str(description.get("dataset", "auto"))
    except (KeyError, TypeError) as error:
        raise DataError(f"the manifest does not say where its drive is ({description!r:.80}): --data FOLDER") from error
    truth = None if description.get("truth") is None else Path(description["truth"])
    if moved_to is None and not path.is_dir():
        raise DataError(f"{path}: no such folder: has the drive moved? Name it: --data FOLDER")
    if moved_to is not None and truth is not None and not truth.is_dir():
        truth = None  # it moved too, or lies beside the drive as usual
    said = description.get
    options = DriveOptions(drive=said("drive"), camera=said("camera"), truth=truth, fx=said("fx"))
    if poses_of(description) != "refined":
        poses: Literal["recorded", "auto"] = "recorded" if poses_of(description) == "recorded" else "auto"
        return open_drive(path, dataset, replace(options, poses=poses))
    refined = refined_poses.load(Path(str(description.get("poses_from", ""))))
    own = {**description, "poses": poses_of(dict(refined.record["drive"]))}
    return RefinedDrive(reopen(own, moved_to), refined)


def reader(name: str) -> ModuleType:
    """Import a data set's file; DataError where there is none of that name, or it lacks a function."""
    if name not in names():
        yours = f"or name the folder of your own by {extensions.VARIABLE}"
        raise DataError(f"unknown data set {name!r}: choose one of auto, {', '.join(names())}, {yours}")
    reader = import_module(f"{__name__}.{name}")
    for function in ("recognises", "open_drive"):
        if not hasattr(reader, function):
            raise DataError(
                f"{reader.__file__}: a data set's file needs a function {function}: see docs/architecture.md"
            )
    return reader


def fitting_data_sets(path: Path) -> list[str]:
    """List the data sets that know the folder's layout; those with LAST only where no other does."""
    readers = {name: reader(name) for name in names()}
    last = {name: getattr(module, "LAST", False) for name, module in readers.items()}
    fitting = [name for name, module in readers.items() if not last[name] and module.recognises(path)]
    return fitting or [name for name, module in readers.items() if last[name] and module.recognises(path)]


def _recognise(path: Path) -> str:
    """Return the one data set that knows the folder's layout."""
    fitting = fitting_data_sets(path)
    if len(fitting) > 1:
        raise DataError(f"{path}: looks like {' and '.join(fitting)}: choose with --dataset {fitting[0]}")
    if not fitting:
        wanted = f"no drive recognised ({', '.join(names())})"
        raise DataError(f"{path}: {wanted}: found {_contents(path)}: see docs/datasets.md for the layouts")
    return fitting[0]


def _contents(path: Path) -> str:
    """Say in a few words what a folder holds."""
    with os.scandir(path) as entries:
        some = list(islice(entries, LISTED))
    folders = sorted(entry.name for entry in some if entry.is_dir())
    files = Counter(Path(entry.name).suffix or "no suffix" for entry in some if not entry.is_dir())
    shown = ", ".join(folders[:4]) + (", ..." if len(folders) > 4 else "")
    words = [f"folders {shown}"] if folders else []
    words += [f"{count} {suffix} files" for suffix, count in files.most_common(3)]
    return ("; ".join(words) or "nothing") + (" and more" if len(some) == LISTED else "")
