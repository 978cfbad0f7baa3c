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

from functools import cached_property
from pathlib import Path

import numpy as np

from priors.drives import DriveOptions, _kitti_maps
from priors.drives._files import (
    IMAGE_SUFFIXES,
    choose,
    first_size,
    follow,
    need,
    read_key_values,
    split_projection,
    stems,
    subfolders,
)
from priors.drives._links import beside, homes
from priors.drives._numbered_drive import NumberedDrive
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.frame_ids import joined
from priors.geometry import invert
from priors.motion import Trajectory
from priors.poses import by_id, parse_pose, read_pose_lines, readable
from priors.text import Line, read_lines
from priors.types import Camera, Matrix

BELOW = 2
"""How many levels below the data set's own folder its sequences are: sequences/, then a sequence."""
CAMERAS = ("image_0", "image_1", "image_2", "image_3")
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
    return [folder for folder in folders if is_drive(folder)]


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a sequence."""
    named = any((folder / name).is_file() for name in ("calib.txt", "times.txt")) or folder.parent.name == "sequences"
    return named and any((folder / name).is_dir() for name in CAMERAS)


class KittiOdometry(NumberedDrive):
    """One camera's view of one sequence."""

    pairs = (("image_0", "image_1"), ("image_2", "image_3"))
    usual_camera = "image_2"
    compensated = True

    def __init__(self, folder: Path, camera: str, truth: Path | None = None) -> None:
        super().__init__(folder, camera, truth)
        self._homes = homes(self.folder, follow(self.folder / camera))
        partner = self.paired_camera()
        self.images = self._list_images(camera)
        self.others = joined(self.images, self._list_images(partner))
        if not self.images:
            others = ", ".join(name for name in CAMERAS if (folder / name).is_dir())
            raise DataError(f"{folder / camera}: no images: download {_image_zip(camera)} (found {others})")
        self.sweeps = joined(self.images, stems(follow(self.folder / "velodyne"), [".bin"]))
        self._calibration = read_key_values(self.folder / "calib.txt")
        K, self._T_cam_cam0 = self._projection(camera)
        self.camera = Camera(K, first_size(self.images.values()))
        self._check_centre()
        self.baseline_m = self._read_baseline(partner) if self.others else None
        self.rig = KITTI if self._is_kittis() else None
        self.maps = self._find_maps()

    @property
    def name(self) -> str:
        """The data set and the sequence; cameras other than image_2 are named too."""
        return f"kitti_odometry_{super().name}"

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        return [self.folder / "calib.txt", *([self._pose_file] if self._pose_file.is_file() else [])]

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each sensor has, for the audit."""
        return {"other": list(self.others), "sweep": list(self.sweeps)}

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the pose of this camera, which stands beside camera 0."""
        T_world_cam0 = self._T_world_cam0(int(id_))
        return None if T_world_cam0 is None else T_world_cam0 @ invert(self._T_cam_cam0)

    def T_world_velo(self, number: int) -> Matrix | None:
        """Return the LiDAR's pose; None for a sequence without poses, or without `Tr`."""
        T_world_cam0, T_cam0_velo = self._T_world_cam0(number), self._T_cam0_velo
        return None if T_world_cam0 is None or T_cam0_velo is None else T_world_cam0 @ T_cam0_velo

    @property
    def T_cam_velo(self) -> Matrix | None:
        """The LiDAR's place at this camera (4, 4), metres; None where calib.txt has no `Tr`."""
        return None if self._T_cam0_velo is None else self._T_cam_cam0 @ self._T_cam0_velo

    @cached_property
    def path(self) -> Trajectory:
        """The trajectory of camera 0, by frame number; lines that are no poses are left out."""
        return Trajectory.of_numbers(readable(self._pose_lines, self._T_world_cam0), self._times)

    @property
    def times_file(self) -> Path:
        """times.txt, there or not."""
        return self.folder / "times.txt"

    def time_s(self, id_: str) -> float | None:
        """Return the time that times.txt tells."""
        return self._times.get(int(id_))

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and which zip has it."""
        other = f"{self.folder}/{self.partner}: no image {id_}: stereo needs both cameras: "
        sweep = f"{self.folder / 'velodyne'}: no sweeps: download data_odometry_velodyne.zip"
        if self.sweeps:
            calib = self.folder / "calib.txt"
            sweep = f"{calib}: no Tr (the grey download has none), so the sweeps cannot be placed: "
            sweep += "take calib.txt from data_odometry_calib.zip"
        raw = RAW_DRIVE.get(self._sequence)
        truth = "the odometry data set has no depth maps for this camera: use --camera image_2"
        if raw is not None and self.camera_name in self.pairs[1]:
            truth = f"no depth map: name the folder that holds train/{raw[0]}/proj_depth with --truth"
        poses = f"{self._pose_file}: no such file, or an empty one: download data_odometry_poses.zip"
        if self._sequence in SEQUENCES[len(RAW_DRIVE) :]:
            poses = f"KITTI publishes no poses of sequence {self._sequence}: take one of 00 to 10"
        return {
            "poses": poses,
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
        (height, width), K = self.camera.size, self.camera.K
        if not (0.25 < K[0, 2] / width < 0.75 and 0.25 < K[1, 2] / height < 0.75):
            centre = f"the calibration's centre is ({K[0, 2]:.0f}, {K[1, 2]:.0f})"
            images = f"the images are {width}x{height}"
            raise DataError(f"{self.folder / 'calib.txt'}: {images}, {centre}: was one of them resized?")

    def _read_baseline(self, partner: str) -> float:
        _, T_other_cam0 = self._projection(partner)
        return self.baseline(float(self._T_cam_cam0[0, 3] - T_other_cam0[0, 3]), self.folder / "calib.txt")

    def _is_kittis(self) -> bool:
        """Tell whether this is a sequence of KITTI's own, by its number and its baseline: others use its layout."""
        least, most = BASELINES_M
        return self._sequence in SEQUENCES and least < (self.baseline_m or 0) < most

    @cached_property
    def _T_cam0_velo(self) -> Matrix | None:
        if "Tr" not in self._calibration:
            return None
        T = np.eye(4)
        T[:3] = need(self._calibration, "Tr", 12, self.folder / "calib.txt").reshape(3, 4)
        return T

    @property
    def _pose_file(self) -> Path:
        files = [beside([home], f"poses/{home.name}.txt", 1) for home in self._homes]
        return next((file for file in files if file.is_file()), files[0])

    @property
    def _sequence(self) -> str:
        """The sequence's number in the data set: the folder's name, or that of the one that it links to."""
        return next((home.name for home in self._homes if home.name in SEQUENCES), self.folder.name)

    @cached_property
    def _pose_lines(self) -> dict[int, Line]:
        """The lines of poses by frame number: by their order, or by the ids that all lines begin with."""
        lines, count = read_pose_lines(self._pose_file) if self._pose_file.is_file() else [], int(self.ids[-1]) + 1
        filled = [line for line in lines if line.text]
        named = by_id(filled, self.images, self._pose_file) if filled else None
        if named is not None:
            return {int(id_): line for id_, line in named.items() if id_.isdecimal()}
        return dict(enumerate(filled if len(filled) == count else lines))

    def _T_world_cam0(self, number: int) -> Matrix | None:
        """Return the pose of camera 0; None for a sequence without poses (11-21, or they were not downloaded)."""
        lines = self._pose_lines
        if not lines:
            return None
        if number not in lines:
            raise DataError(
                f"{self._pose_file}: {len(lines)} poses, none for frame {self.numbered.get(number, number)}: "
                "download data_odometry_poses.zip again, or leave the frame out with --frames"
            )
        return parse_pose(lines[number].text, f"{self._pose_file}: line {lines[number].number}")

    @cached_property
    def _times(self) -> dict[int, float]:
        """Seconds since the first frame, by frame number; empty without times.txt."""
        path = self.times_file
        if not path.is_file():
            return {}
        try:
            return {n: float(line.text) for n, line in enumerate(read_lines(path)) if line.text}
        except ValueError as error:
            raise DataError(f"{path}: expected one number a line ({error}): download it again") from error

    def _find_maps(self) -> dict[str, dict[str, Path]]:
        """Find the raw drive's depth maps: truth and sparse, by this sequence's frame ids."""
        raw_drive, first = RAW_DRIVE.get(self._sequence, ("", 0))
        if self.truth is None or not raw_drive or self.camera_name not in self.pairs[1]:
            return {}
        maps = _kitti_maps.given(self.truth, [raw_drive], f"image_0{self.camera_name[-1]}")
        raw_ids = {id_: f"{int(id_) + first:010d}" for id_ in self.ids}
        by_raw = {what: joined(raw_ids.values(), paths) for what, paths in maps.items()}
        return {
            what: {id_: paths[raw_id] for id_, raw_id in raw_ids.items() if raw_id in paths}
            for what, paths in by_raw.items()
        }


def _image_zip(camera: str) -> str:
    return "data_odometry_gray.zip" if camera in ("image_0", "image_1") else "data_odometry_color.zip"
