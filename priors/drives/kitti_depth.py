"""KITTI depth completion and prediction: the selected frames (data_depth_selection.zip), as downloaded.

    val_selection_cropped/image/2011_09_26_drive_0002_sync_image_0000000005_image_02.png
                         /velodyne_raw/2011_09_26_drive_0002_sync_velodyne_raw_0000000005_image_02.png
                         /groundtruth_depth/2011_09_26_drive_0002_sync_groundtruth_depth_0000000005_image_02.png
                         /intrinsics/2011_09_26_drive_0002_sync_image_0000000005_image_02.txt
    test_depth_completion_anonymous/{image,velodyne_raw,intrinsics}/0000000000.png
    test_depth_prediction_anonymous/{image,intrinsics}/0000000000.png

Quirks kept here (the devkit's readme):
- A "drive" is one of the three folders. Its frames are of many drives and of both colour cameras: there are no pairs,
  no poses, no times.
- Images and maps are cropped to 1216x352 at the bottom; intrinsics, nine numbers a frame, are of the cropped image.
- A map's name differs from its image's in the middle. Frame ids are the images' names, as submissions have them.
- The anonymous folders have no truth: it stays with the benchmark.
"""

from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import DriveOptions
from priors.drives._files import IMAGE_SUFFIXES, choose, search, stems
from priors.drives._single_frames import SingleFrames
from priors.errors import DataError, UsageError
from priors.text import read_text
from priors.types import Camera

BELOW = 2
"""How many levels below the data set's own folder its folders are: depth_selection/, then one of the three."""
MAPS = {"truth": "groundtruth_depth", "sparse": "velodyne_raw"}
DOWNLOAD = "download data_depth_selection.zip"


def recognises(path: Path) -> bool:
    """Tell whether the folder is one of the three, or holds them."""
    return bool(search(path, is_drive, BELOW))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself one of the three."""
    return (folder / "intrinsics").is_dir() and (folder / "image").is_dir()


def open_drive(path: Path, options: DriveOptions) -> "KittiDepth":
    """Open one of the folders; path is it, or a parent of it with options.drive."""
    if options.camera not in (None, KittiDepth.usual_camera):
        raise UsageError(f"{path}: the selection mixes image_02 and image_03: leave --camera {options.camera} out")
    if options.truth is not None:
        raise UsageError(f"{path}: the selection has its own truth: leave --truth out")
    folder = choose(search(path, is_drive, BELOW), options.drive, path, "a selection (image/ and intrinsics/)")
    return KittiDepth(folder)


class KittiDepth(SingleFrames):
    """The frames of a selection."""

    usual_camera = "image"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, self.usual_camera)
        self.images = stems(self.folder / "image", IMAGE_SUFFIXES)
        if not self.images:
            raise DataError(f"{self.folder / 'image'}: no images: {DOWNLOAD}")
        self.maps = {what: self._join(stems(self.folder / name, [".png"]), name) for what, name in MAPS.items()}
        self.camera, _ = self.first_readable()

    @property
    def name(self) -> str:
        """The data set and the selection."""
        return f"kitti_depth_{super().name}"

    def sources(self) -> list[Path]:
        """List the calibration of all frames."""
        return [path for id_ in self.ids if (path := self._intrinsics(id_)).is_file()]

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        reasons = {what: f"{self.folder / name}: no map of {id_}: {DOWNLOAD}" for what, name in MAPS.items()}
        if "anonymous" in self.folder.name:
            reasons["truth"] = f"{self.folder.name} has no truth, the benchmark keeps it: use val_selection_cropped"
        return {
            **super().missing(id_),
            **reasons,
            "other": "the selection has no pairs: use completion, or mono",
            "sweep": "the selection has no sweeps: completion fills its velodyne_raw maps",
            "sky": "KITTI has no sky masks",
        }

    def camera_of(self, id_: str) -> Camera:
        """Return the frame's own camera."""
        return Camera(self._read_K(self._intrinsics(id_)), self.size_of(self.images[id_]))

    @cached_property
    def _read_K(self) -> Any:
        return lru_cache(maxsize=64)(_read_intrinsics)

    def _intrinsics(self, id_: str) -> Path:
        return self.folder / "intrinsics" / f"{id_}.txt"

    def _join(self, files: Mapping[str, Path], kind: str) -> dict[str, Path]:
        """Return maps by frame id: an image's name has `image` where a map's has its kind."""
        named = {stem.replace(f"_sync_{kind}_", "_sync_image_"): path for stem, path in files.items()}
        return {id_: named[id_] for id_ in self.images if id_ in named}


def _read_intrinsics(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Read nine numbers, a row-major K."""
    words = read_text(path, DOWNLOAD).split()
    try:
        K = np.array(list(map(float, words)), np.float64).reshape(3, 3)
    except ValueError as error:
        raise DataError(f"{path}: expected 9 numbers, found {len(words)} words: {DOWNLOAD}") from error
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], (0, 0, 1)):
        raise DataError(f"{path}: is no pinhole camera (fx {K[0, 0]:g}, fy {K[1, 1]:g}): {DOWNLOAD}")
    return K
