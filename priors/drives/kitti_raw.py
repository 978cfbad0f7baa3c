"""KITTI raw: date folders with drive folders in them, as downloaded ("synced+rectified").

    2011_09_26/calib_{cam_to_cam,velo_to_cam,imu_to_velo}.txt
    2011_09_26/2011_09_26_drive_0001_sync/{image_00..03,velodyne_points,oxts}/{data/,timestamps.txt}

Quirks kept here:
- Everything is joined by frame id: drives miss scans, images may cover fewer frames than the LiDAR.
- image_02 is not camera 0: each P_rect has its own offset, and the sweep goes through camera 0's rectification.
- Poses come from oxts in metres, dead-reckoned from the velocities where they are recorded (_oxts.py). The world is the
  IMU's frame at the first oxts file (x forward, y left, z up).
- The oxts record kept for a frame was taken up to 5 ms before or after it: _oxts.py interpolates.
- A sweep is one turn of the scanner, not a moment: the cameras are triggered when it faces forward, what lies to the
  left was measured up to 50 ms before that, to the right after it.
- Pixel centres are integers: with the two facts above our projection repeats the official `velodyne_raw` maps
  (99.99 % of the common pixels within 2 cm on drive 0001; tests/test_kitti_raw.py).
- The depth maps (`groundtruth`, `velodyne_raw`) are other downloads: looked for beside, or under --truth.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import DriveOptions, _kitti_maps
from priors.drives._camera_drive import Files, Readers
from priors.drives._files import (
    IMAGE_SUFFIXES,
    choose,
    follow,
    need,
    read_key_values,
    read_sized,
    read_times,
    revise,
    search,
    split_projection,
    stems,
)
from priors.drives._links import beside, homes
from priors.drives._numbered_drive import NumberedDrive
from priors.drives._oxts import DEAD_RECKONING, Track
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.frame_ids import joined
from priors.geometry import invert
from priors.motion import Trajectory
from priors.types import Camera, Matrix

BELOW = 2
"""How many levels below the data set's own folder its drives are: a date, then a drive."""
CAMERAS_FILE, VELO_FILE, IMU_FILE = "calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"
CALIBRATION = "download the date's calibration again"
CAMERAS = ("image_00", "image_01", "image_02", "image_03")
DATES = ("2011_09_26", "2011_09_28", "2011_09_29", "2011_09_30", "2011_10_03")
"""Of KITTI's own recordings; others use its layout."""


def recognises(path: Path) -> bool:
    """Tell whether the folder is a drive, a date or a folder of dates."""
    return bool(_drive_folders(path))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a drive."""
    return any((folder / name / "data").is_dir() for name in CAMERAS)


def open_drive(path: Path, options: DriveOptions) -> "KittiRaw":
    """Open one drive; path is the drive's folder, or a parent of it with options.drive."""
    folder = choose(_drive_folders(path), options.drive, path, "a drive's folder (image_02/data, velodyne_points/data)")
    with_images = [name for name in ("image_02", "image_00", "image_03", "image_01") if _images(folder, name)]
    camera = options.camera or next(iter(with_images), "image_02")
    return KittiRaw(folder, camera, options.truth, by_velocity=options.poses != "recorded")


def _drive_folders(path: Path) -> list[Path]:
    """List the drives at path, or where it is none itself, one or two levels below."""
    return search(path, is_drive, BELOW)


@dataclass(frozen=True)
class RigCalibration:
    """What a date's three files say about one camera of the rig."""

    camera: Camera
    T_cam_cam0: Matrix
    T_cam0_velo: Matrix | None
    T_velo_imu: Matrix | None


class KittiRaw(NumberedDrive):
    """One camera's view of one drive."""

    pairs = (("image_00", "image_01"), ("image_02", "image_03"))
    usual_camera = "image_02"
    posed = "lidar"

    def __init__(
        self, folder: Path, camera: str = "image_02", truth: Path | None = None, *, by_velocity: bool = True
    ) -> None:
        super().__init__(folder, camera, truth)
        folder, partner = self.folder, self.paired_camera()
        self.images = _images(folder, camera)
        self.others = joined(self.images, _images(folder, partner))
        if not self.images:
            raise DataError(f"{folder / camera / 'data'}: no PNG or JPEG images: download the drive's synced data")
        self.sweeps = joined(self.images, stems(follow(folder / "velodyne_points") / "data", [".bin"]))
        self._track = Track(follow(folder / "oxts"), by_velocity=by_velocity)
        self._homes = homes(folder, follow(folder / camera) / "data")
        self._files = {name: beside(self._homes, name) for name in (CAMERAS_FILE, VELO_FILE, IMU_FILE)}
        self.calibration = read_calibration(self._files, camera)
        self.camera = self.calibration.camera
        self.baseline_m = self._read_baseline(partner) if self.others else None
        self.rig = KITTI if any(home.name.startswith(DATES) for home in self._homes) else None
        self.maps = self._find_maps()

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records; where the folder is a link, the path is its target's."""
        described = {**super().describe(), "path": str(self.folder.resolve())}
        return {**described, "poses": "dead-reckoned"} if self._track.dead_reckoned else described

    def fingerprint(self) -> str:
        """Digest what places the images; other poses of the same files have another one."""
        of_files = super().fingerprint()
        return revise(of_files, DEAD_RECKONING) if self._track.dead_reckoned else of_files

    def travel_deg(self) -> tuple[float, float] | None:
        """Return at which angle to its heading the drive travels, to the left, by positions and by velocities."""
        return self._track.travel_deg()

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        files = {path.name: path for home in reversed(self._homes) for path in home.parent.glob("calib_*.txt")}
        return [*(files[name] for name in sorted(files)), *self._track.sources]

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each sensor has, for the audit."""
        oxts = joined(self.images, self._track.files)
        return {"other": list(self.others), "sweep": list(self.sweeps), "oxts": list(oxts)}

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also the street's sky masks."""
        readers = super().readers(id_)
        if id_ in self._skies:
            readers["sky"] = lambda: read_sized(self._skies[id_], self.camera) > 127
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the street's sky masks."""
        files: Files = {"sky": lambda: self._skies.get(id_)}
        return super().files(id_) | files

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        sweep = f"no sweeps in {self.folder / 'velodyne_points' / 'data'}: download the velodyne data"
        if self.sweeps:
            sweep = f"{self._files[VELO_FILE]}: no such file, so the sweeps cannot be placed: {CALIBRATION}"
        return {
            **self._lacking_pose,
            "poses": f"{self.folder / 'oxts' / 'data'}: no record {id_}.txt: download the drive's oxts",
            "other": f"{self.folder}/{self.partner}/data: no image {id_}: stereo needs both cameras: download it",
            "sweep": sweep,
            **self._lacking_maps,
            "sky": f"no sky masks beside {self.folder.name}: KITTI has none, the embedded street has",
        }

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the pose that oxts tells; None where the frame has no record there."""
        T_world_velo = self._T_world_velo(id_)
        return None if T_world_velo is None or self.T_cam_velo is None else T_world_velo @ invert(self.T_cam_velo)

    def T_world_velo(self, number: int) -> Matrix | None:
        """Return the LiDAR's pose, which oxts tells; None where the number has no record there."""
        return self._T_world_velo(self._track.id_of(number))

    @property
    def path(self) -> Trajectory:
        """The trajectory of the recorded positions, by frame number."""
        return self._track.path

    def time_s(self, id_: str) -> float | None:
        """Return the camera's own time stamp."""
        return self._times.get(int(id_))

    @cached_property
    def _skies(self) -> dict[str, Path]:
        """Map frame id to sky mask (255 = sky); only the embedded street has them."""
        return joined(self.images, stems(self.folder / "sky" / self.camera_name / "data", [".png"]))

    @cached_property
    def T_cam_velo(self) -> Matrix | None:
        """The LiDAR's place at this camera (4, 4), metres; None without its calibration."""
        T_cam0_velo = self.calibration.T_cam0_velo
        return None if T_cam0_velo is None else self.calibration.T_cam_cam0 @ T_cam0_velo

    @cached_property
    def _times(self) -> dict[int, float]:
        """Camera times by frame number; the file counts frames from 0, whichever images were kept."""
        path = self.folder / self.camera_name / "timestamps.txt"
        return read_times(path) if path.exists() else {}

    def _read_baseline(self, partner: str) -> float:
        T_other_cam0 = read_calibration(self._files, partner).T_cam_cam0
        right_m = float(self.calibration.T_cam_cam0[0, 3] - T_other_cam0[0, 3])
        return self.baseline(right_m, self._files[CAMERAS_FILE])

    def _find_maps(self) -> dict[str, dict[str, Path]]:
        """Find the drive's depth maps: truth and sparse, by frame id."""
        if self.truth is not None:
            maps = _kitti_maps.given(self.truth, self._names, self.camera_name)
        else:
            maps = _kitti_maps.beside(self._above, self._names, self.camera_name, self.camera.size)
        return {what: joined(self.images, paths) for what, paths in maps.items()}

    @cached_property
    def _lacking_maps(self) -> dict[str, str]:
        """Say why a frame has no map, by what it would be read as."""
        reasons = {}
        for what, paths in self.maps.items():
            if paths:
                folder = next(iter(paths.values())).parent
                reasons[what] = f"{folder}: no map of this frame (KITTI has none of a drive's ends): leave it out"
            else:
                reasons[what] = _kitti_maps.lacking(self._above, self._names, self.camera_name, what)
        return reasons

    @property
    def _above(self) -> list[Path]:
        return list(dict.fromkeys(above for home in self._homes for above in list(home.parents)[:3]))

    @property
    def _names(self) -> list[str]:
        """What the drive may be called where its depth maps are: its folder's name, and where links lead."""
        return list(dict.fromkeys(home.name for home in self._homes))

    @cached_property
    def _lacking_pose(self) -> dict[str, str]:
        """Say which file the poses lack, where there are oxts records; nothing where all are there, or no records."""
        for name in (VELO_FILE, IMU_FILE):
            if self._track.files and not self._files[name].exists():
                return {"pose": f"{self._files[name]}: no such file, so oxts tells no camera's pose: {CALIBRATION}"}
        return {}

    def _T_world_velo(self, id_: str) -> Matrix | None:
        T_velo_imu, T_world_imu = self.calibration.T_velo_imu, self._track.T_world_imu(id_)
        return None if T_velo_imu is None or T_world_imu is None else T_world_imu @ invert(T_velo_imu)


def _images(folder: Path, camera: str) -> dict[str, Path]:
    images = stems(follow(folder / camera) / "data", IMAGE_SUFFIXES)
    return {id_: path for id_, path in images.items() if id_.isdecimal()}


def read_calibration(files: Mapping[str, Path], camera: str) -> RigCalibration:
    """Read a date's calibration files, by their names, for one camera (image_00 .. image_03)."""
    path = files[CAMERAS_FILE]
    values = read_key_values(path)
    number = camera[-2:]
    P = need(values, f"P_rect_{number}", 12, path).reshape(3, 4)
    K, T_cam_cam0 = split_projection(P, f"P_rect_{number}", path)
    width, height = need(values, f"S_rect_{number}", 2, path)
    R_rect = np.eye(4)
    R_rect[:3, :3] = need(values, "R_rect_00", 9, path).reshape(3, 3)
    T_cam_velo = read_rigid(files[VELO_FILE])
    return RigCalibration(
        camera=Camera(K, (int(height), int(width))),
        T_cam_cam0=T_cam_cam0,
        T_cam0_velo=None if T_cam_velo is None else R_rect @ T_cam_velo,
        T_velo_imu=read_rigid(files[IMU_FILE]),
    )


def read_rigid(path: Path) -> Matrix | None:
    """Read R and T as (4, 4); None where the file is not there (image-only downloads)."""
    if not path.exists():
        return None
    values = read_key_values(path)
    T_a_b = np.eye(4)
    T_a_b[:3, :3] = need(values, "R", 9, path).reshape(3, 3)
    T_a_b[:3, 3] = need(values, "T", 3, path)
    return T_a_b
