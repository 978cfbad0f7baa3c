"""KITTI object, as downloaded: images and sweeps that have nothing to do with each other, each with its calibration.

    training/{image_2,image_3}/000000.png, velodyne/000000.bin, calib/000000.txt, label_2/
    testing/, the same without labels

Quirks kept here (the devkit's readme):
- A "drive" is a split. Its frames are of many drives: there are no poses, no times and no motion between them.
- calib/ has P0..P3, R0_rect, Tr_velo_to_cam and Tr_imu_to_velo of each frame; the image's own header tells its size.
- A sweep goes through camera 0's rectification R0_rect, then to this camera by its P's offset. It is not compensated
  for the car's motion, and nothing here tells the motion: at the sides points may lie a metre off.
- image_3 is another download. Labels are not read.
"""

import re
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import DriveOptions
from priors.drives._camera_drive import Files
from priors.drives._files import (
    IMAGE_SUFFIXES,
    choose,
    need,
    read_key_values,
    search,
    split_projection,
    stems,
)
from priors.drives._rigs import KITTI
from priors.drives._single_frames import SinglePairs, has_file
from priors.errors import DataError, UsageError
from priors.types import Matrix

BELOW = 2
"""How many levels below the data set's own folder its splits are: data_object/, then a split."""
IMAGE = re.compile(r"\d{6}\.(png|jpe?g)", re.IGNORECASE)
CALIBRATION = "download data_object_calib.zip"


def recognises(path: Path) -> bool:
    """Tell whether the folder is a split, or holds splits."""
    return bool(search(path, is_drive, BELOW))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a split: images by number, and a calibration of each or sweeps beside them."""
    beside = any((folder / name).is_dir() for name in ("calib", "velodyne", "label_2"))
    return (
        beside
        and not any((folder / name).is_file() for name in ("calib.txt", "times.txt"))
        and has_file(folder / "image_2", IMAGE)
    )


def open_drive(path: Path, options: DriveOptions) -> "KittiObject":
    """Open one split; path is its folder, or the data set's with options.drive."""
    if options.truth is not None:
        raise UsageError(f"{path}: KITTI's object benchmark has no depth maps: leave --truth out")
    folder = choose(search(path, is_drive, BELOW), options.drive, path, "a split (training/image_2/000000.png, calib/)")
    return KittiObject(folder, options.camera or "image_2")


class KittiObject(SinglePairs):
    """One camera's view of the frames of a split."""

    pairs = (("image_2", "image_3"),)
    usual_camera = "image_2"

    def __init__(self, folder: Path, camera: str) -> None:
        super().__init__(folder, camera)
        partner = self.paired_camera()
        self.images = stems(self.folder / camera, IMAGE_SUFFIXES)
        if not self.images:
            raise DataError(f"{self.folder / camera}: no images: download data_object_{camera}.zip")
        self.others = {i: path for i, path in stems(self.folder / partner, IMAGE_SUFFIXES).items() if i in self.images}
        self.sweeps = {i: p for i, p in stems(self.folder / "velodyne", [".bin"]).items() if i in self.images}
        self.camera, self.baseline_m = self.first_readable()
        self.rig = KITTI

    @property
    def name(self) -> str:
        """The data set and the split."""
        return f"kitti_object_{super().name}"

    def sources(self) -> list[Path]:
        """List the first calibration that is there; a frame's own is watched with what it reads."""
        places = (self._calibration_places(id_) for id_ in self.ids)
        return [next(path for around in places for path in around if path.is_file())]

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the calibration that image and sweep go through."""
        files: Files = {
            "sweep.calibration": lambda: self.calibration_file(id_),
            "image.calibration": lambda: self.calibration_file(id_),
        }
        return super().files(id_) | files

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and which zip has it."""
        truth = "KITTI's object benchmark has no depth maps"
        zip_ = "data_object_image_3.zip" if self.partner == "image_3" else "data_object_image_2.zip"
        return {
            **super().missing(id_),
            "other": f"{self.folder}/{self.partner}: no image {id_}: stereo needs both cameras: download {zip_}",
            "sweep": f"{self.folder / 'velodyne'}: no sweep {id_}.bin: download data_object_velodyne.zip",
            "truth": truth,
            "sparse": truth,
            "sky": "KITTI has no sky masks",
        }

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Return the LiDAR's place at the frame."""
        if id_ not in self.sweeps:
            return None
        path = self.calibration_file(id_)
        values = self._calibration(path)
        R_rect, T_cam0_velo = np.eye(4), np.eye(4)
        R_rect[:3, :3] = need(values, "R0_rect", 9, path).reshape(3, 3)
        T_cam0_velo[:3] = need(values, "Tr_velo_to_cam", 12, path).reshape(3, 4)
        return self.projection(id_, self.camera_name)[1] @ R_rect @ T_cam0_velo

    @cached_property
    def _calibration(self) -> Any:
        return lru_cache(maxsize=64)(read_key_values)

    def projection(self, id_: str, camera: str) -> tuple[Matrix, Matrix]:
        """Return K (3, 3) and T_cam_cam0 (4, 4) of a camera at a frame, metres."""
        path, key = self.calibration_file(id_), f"P{camera[-1]}"
        return split_projection(need(self._calibration(path), key, 12, path).reshape(3, 4), key, path)

    def calibration_file(self, id_: str) -> Path:
        """Return the frame's calibration; DataError where there is none."""
        places = self._calibration_places(id_)
        found = next((path for path in places if path.is_file()), None)
        if found is None:
            raise DataError(f"{places[0]}: no such file: {CALIBRATION}")
        return found

    def _calibration_places(self, id_: str) -> list[Path]:
        """List where a frame's calibration may be: in the split, or in the other download beside."""
        split = self.folder.name
        above = [parent / "data_object_calib" / split for parent in list(self.folder.parents)[:2]]
        return [folder / "calib" / f"{id_}.txt" for folder in (self.folder, *above)]
