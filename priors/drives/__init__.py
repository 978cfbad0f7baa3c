"""Drives: one file per data set, and the folder is the registry.

A data set's file has two functions: `recognises(path)` and `open_drive(path, options)`. Adding the file adds the
`--dataset` choice; listing the choices imports none of them.
"""

import pkgutil
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from priors.errors import DataError
from priors.types import Drive


@dataclass(frozen=True)
class DriveOptions:
    """What narrows a folder down to one camera of one drive."""

    drive: str | None = None
    """Drive, sequence or log to read where DATA holds several, e.g. 2011_09_26_drive_0001_sync or 06."""
    camera: str | None = None
    """Camera to make depth for, by the data set's own name (image_02, ring_front_center, ...); default: the first
    with a partner for stereo."""
    truth: Path | None = None
    """Folder with KITTI depth maps: holds train/<drive>/proj_depth or <drive>/proj_depth."""


def names() -> list[str]:
    """List the data sets, without importing their readers."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def open_drive(path: Path, dataset: str = "auto", options: DriveOptions | None = None) -> Drive:
    """Open the drive in a folder; 'auto' recognises the data set from the folder's content.

    Raises:
        DataError: the folder is missing, nothing recognises it, or it holds several drives and none is named.
    """
    path = Path(path)
    if not path.is_dir():
        raise DataError(f"{path}: no such folder")
    candidates = names() if dataset == "auto" else [dataset]
    for name in candidates:
        if name not in names():
            raise DataError(f"unknown data set {name!r}: choose one of {', '.join(names())}")
        reader = import_module(f"{__name__}.{name}")
        if dataset != "auto" or reader.recognises(path):
            drive: Drive = reader.open_drive(path, options or DriveOptions())
            return drive
    raise DataError(
        f"{path}: no drive recognised ({', '.join(names())}): name it with --dataset, or see docs/datasets.md"
    )
