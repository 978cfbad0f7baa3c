"""KITTI odometry: sequences 00-21 with poses for 00-10, as downloaded.

    [dataset/]sequences/06/{image_0..3/000000.png, velodyne/000000.bin, calib.txt, times.txt}
    [dataset/]poses/06.txt

Quirks kept here:
- The data set comes as several zips. The grey one has no colour, no velodyne, and a calib.txt without Tr; what is
  missing is said only when it is needed, with the zip's name.
- Poses are T_world_cam0 of the rectified camera 0; image_1..3 are shifted from it by their P's offset.
- Sweeps are motion compensated already (unlike those of the raw drives), so they carry no times.
- calib.txt has no image size: the first readable image says it.
- The sequences are cut from raw drives, whose depth maps serve as truth (--truth DIR) for image_2 and image_3.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from priors import codecs
from priors.drives import DriveOptions, _kitti_maps
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_baseline,
    check_size,
    choose,
    digest,
    first_size,
    follow,
    need,
    parse_pose,
    read_key_values,
    read_sized,
    read_text,
    split_projection,
    stems,
    subfolders,
)
from priors.drives._rigs import KITTI
from priors.drives.kitti_raw import read_sweep_file
from priors.errors import DataError
from priors.geometry import invert
from priors.types import Camera, Depth, Frame, Matrix, Sweep

PARTNER = {"image_0": "image_1", "image_1": "image_0", "image_2": "image_3", "image_3": "image_2"}
SEQUENCES = tuple(f"{number:02}" for number in range(22))
BASELINES_M = (0.53, 0.5395)
# Sequence -> raw drive and the raw frame that became frame 0 (the devkit's readme).
RAW_DRIVE = {
    "00": ("2011_10_03_drive_0027_sync", 0),
    "01": ("2011_10_03_drive_0042_sync", 0),
    "02": ("2011_10_03_drive_0034_sync", 0),
    "03": ("2011_09_26_drive_0067_sync", 0),
    "04": ("2011_09_30_drive_0016_sync", 0),
    "05": ("2011_09_30_drive_0018_sync", 0),
    "06": ("2011_09_30_drive_0020_sync", 0),
    "07": ("2011_09_30_drive_0027_sync", 0),
    "08": ("2011_09_30_drive_0028_sync", 1100),
    "09": ("2011_09_30_drive_0033_sync", 0),
    "10": ("2011_09_30_drive_0034_sync", 0),
}


def recognises(path: Path) -> bool:
    """Tell whether the folder is a sequence, or holds sequences."""
    return bool(_sequences(path))


def open_drive(path: Path, options: DriveOptions) -> "KittiOdometry":
    """Open one sequence; path is its folder, or the data set's root with options.drive."""
    folder = choose(_sequences(path), options.drive, path, "a sequence (sequences/06/image_0)")
    with_images = [name for name in ("image_2", "image_0", "image_3", "image_1") if (folder / name).is_dir()]
    return KittiOdometry(folder, options.camera or with_images[0], options.truth)


def _sequences(path: Path) -> list[Path]:
    """List the sequences at path, or in it, or in its sequences/ or dataset/sequences/."""
    folders = [path, *subfolders(path / "sequences"), *subfolders(path / "dataset" / "sequences")]
    if path.name == "sequences":
        folders += subfolders(path)
    return [folder for folder in folders if (folder / "calib.txt").is_file() and _has_images(folder)]


def _has_images(folder: Path) -> bool:
    return any((folder / name).is_dir() for name in PARTNER)


class KittiOdometry:
    """One camera's view of one sequence."""

    def __init__(self, folder: Path, camera: str, truth: Path | None = None) -> None:
        self.folder, self.camera_name, self._truth_option = folder.absolute(), camera, truth
        if camera not in PARTNER:
            raise DataError(f"{folder}: no camera {camera!r}: choose one of {', '.join(PARTNER)}")
        self._images = self._list_images(camera)
        if not self._images:
            found = ", ".join(name for name in PARTNER if (folder / name).is_dir())
            raise DataError(f"{folder / camera}: no images: download {_image_zip(camera)} (found {found})")
        self._others = self._list_images(PARTNER[camera])
        self._sweeps = stems(follow(self.folder / "velodyne"), [".bin"])
        self.ids: Sequence[str] = list(self._images)
        self._calibration = read_key_values(self.folder / "calib.txt")
        K, self._T_cam_cam0 = self._projection(camera)
        self._camera = Camera(K, first_size(self._images.values()))
        self._check_centre()
        self.side: Literal["left", "right"] = "left" if camera in ("image_0", "image_2") else "right"
        self.baseline_m = self._read_baseline()
        self._maps, self._first_raw = self._find_maps()

    @property
    def name(self) -> str:
        """Sequence's name; cameras other than image_2 are named too."""
        name = f"kitti_odometry_{self.folder.name}"
        return name if self.camera_name == "image_2" else f"{name}-{self.camera_name}"

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records and `reopen` needs."""
        truth = None if self._truth_option is None else str(Path(self._truth_option).resolve())
        return {"dataset": "kitti_odometry", "path": str(self.folder), "camera": self.camera_name, "truth": truth}

    def fingerprint(self) -> str:
        """Digest calibration, poses and the first image."""
        poses = [self._pose_file] if self._pose_file.is_file() else []
        return digest([self.folder / "calib.txt", *poses, next(iter(self._images.values()))])

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids each sensor has, for the audit."""
        return {"other": list(self._others), "sweep": list(self._sweeps)}

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        id_ = self.ids[index]
        sources: dict[str, Any] = {"image": partial(read_sized, self._images[id_], self._camera)}
        if id_ in self._others:
            sources["other"] = partial(read_sized, self._others[id_], self._camera)
        if self._sweeps and self._T_cam0_velo is not None:
            sources["sweep"] = lambda offset=0: self._read_sweep(int(id_) + offset, len(id_))
        for what, kind in (("truth", "groundtruth"), ("sparse", "velodyne_raw")):
            map_ = self._map(kind, id_)
            if map_ is not None:
                sources[what] = partial(self._read_map, map_)
        T_world_cam0 = self._pose(id_)
        return Frame(
            id=id_,
            camera=self._camera,
            readers=sources,
            missing=self._missing(id_),
            T_world_cam=None if T_world_cam0 is None else T_world_cam0 @ invert(self._T_cam_cam0),
            T_cam_lidar=None if self._T_cam0_velo is None else self._T_cam_cam0 @ self._T_cam0_velo,
            time_s=self._times.get(id_),
            baseline_m=self.baseline_m,
            rig=KITTI if self._is_kittis() else None,
            side=self.side,
        )

    def _missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and which zip has it."""
        other = f"{self.folder / PARTNER[self.camera_name]}: no image {id_}: stereo needs both cameras: "
        sweep = f"{self.folder / 'velodyne'}: no sweeps: download data_odometry_velodyne.zip"
        if self._sweeps:
            calib = self.folder / "calib.txt"
            sweep = f"{calib}: no Tr (the grey download has none), so the sweeps cannot be placed: "
            sweep += "take calib.txt from data_odometry_calib.zip"
        raw = RAW_DRIVE.get(self.folder.name)
        truth = "the odometry data set has no depth maps for this camera: use --camera image_2"
        if raw is not None and self.camera_name in ("image_2", "image_3"):
            truth = f"no depth map: name the folder that holds train/{raw[0]}/proj_depth with --truth"
        return {
            "other": other + f"download {_image_zip(self.camera_name)}",
            "sweep": sweep,
            "truth": truth,
            "sparse": truth,
            "sky": "KITTI has no sky masks",
        }

    def _list_images(self, camera: str) -> dict[str, Path]:
        images = stems(follow(self.folder / camera), IMAGE_SUFFIXES)
        return {id_: path for id_, path in images.items() if id_.isdecimal()}

    def _projection(self, camera: str) -> tuple[Matrix, Matrix]:
        key, path = f"P{camera[-1]}", self.folder / "calib.txt"
        return split_projection(need(self._calibration, key, 12, path).reshape(3, 4), key, path)

    def _check_centre(self) -> None:
        """Raise DataError where the principal point is outside the image's middle half: one of them was resized."""
        (height, width), K = self._camera.size, self._camera.K
        if not (0.25 < K[0, 2] / width < 0.75 and 0.25 < K[1, 2] / height < 0.75):
            found = f"the images are {width}x{height}, the calibration's centre is ({K[0, 2]:.0f}, {K[1, 2]:.0f})"
            raise DataError(f"{self.folder / 'calib.txt'}: {found}: was one of them resized?")

    def _read_baseline(self) -> float | None:
        if not self._others:
            return None
        _, T_other_cam0 = self._projection(PARTNER[self.camera_name])
        offset_m = float(self._T_cam_cam0[0, 3] - T_other_cam0[0, 3])
        what = f"from {self.camera_name} to {PARTNER[self.camera_name]}"
        return check_baseline(offset_m if self.side == "left" else -offset_m, what, self.folder / "calib.txt")

    def _is_kittis(self) -> bool:
        """Tell whether this is a sequence of KITTI's own, by its number and its baseline: others use its layout."""
        least, most = BASELINES_M
        return self.folder.name in SEQUENCES and least < (self.baseline_m or 0) < most

    @cached_property
    def _T_cam0_velo(self) -> Matrix | None:
        if "Tr" not in self._calibration:
            return None
        T = np.eye(4)
        T[:3] = need(self._calibration, "Tr", 12, self.folder / "calib.txt").reshape(3, 4)
        return T

    @property
    def _pose_file(self) -> Path:
        return self.folder.parent.parent / "poses" / f"{self.folder.name}.txt"

    @cached_property
    def _pose_lines(self) -> list[str]:
        return read_text(self._pose_file).splitlines() if self._pose_file.is_file() else []

    def _pose(self, id_: str) -> Matrix | None:
        """T_world_cam0 at a frame; None where the sequence has no poses (11-21, or the poses were not downloaded)."""
        lines, number = self._pose_lines, int(id_)
        if not lines:
            return None
        if number >= len(lines):
            raise DataError(
                f"{self._pose_file}: {len(lines)} poses, none for frame {id_}: "
                "download data_odometry_poses.zip again, or leave the frame out with --frames"
            )
        return parse_pose(lines[number], f"{self._pose_file}: line {number + 1}")

    @cached_property
    def _times(self) -> dict[str, float]:
        """Seconds since the first frame, by frame id; empty without times.txt."""
        path, width = self.folder / "times.txt", len(self.ids[0])
        if not path.is_file():
            return {}
        try:
            return {f"{n:0{width}d}": float(line) for n, line in enumerate(read_text(path).split())}
        except ValueError as error:
            raise DataError(f"{path}: expected one number a line ({error}): download it again") from error

    def _read_sweep(self, number: int, width: int) -> Sweep | None:
        id_ = f"{number:0{width}d}"
        if id_ not in self._sweeps or self._T_cam0_velo is None:
            return None
        T_world_cam0 = self._pose(id_)
        T_world_lidar = None if T_world_cam0 is None else T_world_cam0 @ self._T_cam0_velo
        return Sweep(read_sweep_file(self._sweeps[id_]), T_world_lidar)

    def _find_maps(self) -> tuple[dict[str, dict[str, Path]], int]:
        """Find the raw drive's depth maps by kind and raw frame id, and the raw frame that is frame 0."""
        raw_drive, first = RAW_DRIVE.get(self.folder.name, ("", 0))
        if self._truth_option is None or not raw_drive or self.camera_name not in ("image_2", "image_3"):
            return {}, first
        return _kitti_maps.given(Path(self._truth_option), raw_drive, f"image_0{self.camera_name[-1]}"), first

    def _map(self, kind: str, id_: str) -> Path | None:
        return self._maps.get(kind, {}).get(f"{int(id_) + self._first_raw:010d}")

    def _read_map(self, path: Path) -> Depth:
        return Depth(check_size(codecs.read_depth_png(path), path, self._camera))


def _image_zip(camera: str) -> str:
    return "data_odometry_gray.zip" if camera in ("image_0", "image_1") else "data_odometry_color.zip"
