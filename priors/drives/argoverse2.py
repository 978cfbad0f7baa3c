"""Argoverse 2: logs of the sensor data set, as downloaded.

    <split>/<log>/sensors/cameras/ring_front_center/315967376859506000.jpg      9 cameras
                 /sensors/lidar/315967376859990000.feather
                 /calibration/{intrinsics,egovehicle_SE3_sensor}.feather
                 /city_SE3_egovehicle.feather

Quirks kept here (the data set's guide and av2-api: pinhole_camera.py, io.py):
- Tables are Feather files, read by pyarrow: the extra argoverse2.
- Frame ids are the image's nanoseconds. Cameras run at 20 Hz, the LiDAR at 10 Hz: an image takes the sweep nearest in
  time, at most 51 ms away, and sweep(k) counts sweeps from there, not images.
- Images are undistorted already: k1 k2 k3 of the intrinsics describe the lens as it was. Applying them is wrong.
- ring_front_center stands upright: it is higher than wide.
- Sweeps are in the vehicle's frame and motion compensated to their own time. The vehicle moves between sweep and image:
  a frame's T_cam_lidar accounts for that.
- The stereo cameras are turned to rows by their calibration when they are read, whether they were so before or not.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.drives import DriveOptions
from priors.drives._by_time import at_time, by_time
from priors.drives._feather import read_feather
from priors.drives._files import IMAGE_SUFFIXES, check_baseline, choose, search
from priors.drives._points import only_points
from priors.drives._rectified import RectifiedCamera, rectify_pair, to_pose
from priors.drives._timed_drive import TimedDrive
from priors.errors import DataError, UsageError
from priors.types import Camera, Matrix

BELOW = 3
"""How many levels below a folder its logs may be: sensor/, a split, then a log."""
INTRINSICS, PLACES, POSES = "intrinsics.feather", "egovehicle_SE3_sensor.feather", "city_SE3_egovehicle.feather"
PAIR = ("stereo_front_left", "stereo_front_right")
DEFAULTS = (PAIR[0], "ring_front_center")
QUATERNION, TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")
K_COLUMNS = ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")
POSE_GAP_NS = 200_000_000  # poses farther apart are not interpolated


def recognises(path: Path) -> bool:
    """Tell whether the folder is a log, or holds logs up to three levels below."""
    return bool(search(path, is_drive, BELOW))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a log."""
    return (folder / "sensors" / "cameras").is_dir() and (folder / "calibration").is_dir()


def open_drive(path: Path, options: DriveOptions) -> "Argoverse2":
    """Open one log; path is its folder, or a parent of it with options.drive."""
    if options.truth is not None:
        raise UsageError(f"{path}: Argoverse 2 has no depth maps: leave --truth out")
    folder = choose(search(path, is_drive, BELOW), options.drive, path, "a log (sensors/cameras, calibration)")
    cameras = folder / "sensors" / "cameras"
    return Argoverse2(folder, options.camera or next((c for c in DEFAULTS if (cameras / c).is_dir()), DEFAULTS[-1]))


class Argoverse2(TimedDrive):
    """One camera's view of one log."""

    pairs = (PAIR,)
    tick_s, near_sweep, near_other = 1e-9, 51_000_000, 10_000_000

    def __init__(self, folder: Path, camera: str) -> None:
        super().__init__(folder, camera)
        images = by_time(self._cameras / camera, IMAGE_SUFFIXES)
        if not images:
            found = ", ".join(sorted(path.name for path in self._cameras.iterdir() if path.is_dir()))
            raise DataError(f"{self._cameras / camera}: no images: choose a --camera (found {found or 'none'})")
        self.images = {str(time): path for time, path in images.items()}
        self.partner_images = by_time(self._cameras / self.partner, IMAGE_SUFFIXES) if self.partner else {}
        self.sweeps = by_time(self.folder / "sensors" / "lidar", [".feather"])
        self.T_ego_lidar = np.eye(4)
        self._rows = self._read_rows()
        self.rectified, self.partner_rectified = self._read_cameras()
        self.camera = self.rectified.camera
        self._pose_times, self._poses = self._read_poses()

    @property
    def name(self) -> str:
        """The log, and the camera."""
        return f"{self.folder.name}-{self.camera_name}"

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        files = [self._calibration(INTRINSICS), self._calibration(PLACES), self.folder / POSES]
        return [path for path in files if path.is_file()]

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        other = f"ring cameras have no partner: stereo needs --camera {PAIR[0]}"
        if self.partner is not None:
            other = f"{self._cameras / self.partner}: no image within 10 ms of {id_}: stereo needs both: download it"
        truth = "Argoverse 2 has no depth maps: score against the LiDAR (`priors eval --against`)"
        reasons = {
            "other": other,
            "sweep": f"{self.folder / 'sensors' / 'lidar'}: no sweeps: download the log's lidar folder",
            "truth": truth,
            "sparse": "Argoverse 2 has no sparse depth maps: use --completion.source lidar",
            "sky": "Argoverse 2 has no sky masks",
        }
        lost = not (self.folder / POSES).is_file()
        return reasons | ({"pose": f"{self.folder / POSES}: no such file: download the log again"} if lost else {})

    def T_world_ego(self, time: int) -> Matrix | None:
        """Return the vehicle's pose at a time in ns: stored, or interpolated between the poses around; else None."""
        return at_time(self._pose_times, self._pose, time, POSE_GAP_NS)

    def read_points(self, path: Path) -> npt.NDArray[np.float32]:
        """Read a sweep's points (n, 3), metres; values that no scanner measures are left out."""
        columns = read_feather(path, "xyz")
        xyz_m = np.stack([columns[axis].astype(np.float32) for axis in "xyz"], axis=1)
        if not len(xyz_m):
            raise DataError(f"{path}: empty sweep: download it again, or leave the frame out with --frames")
        return xyz_m[only_points(xyz_m, path, "x y z in metres")]

    @property
    def _cameras(self) -> Path:
        return self.folder / "sensors" / "cameras"

    def _calibration(self, name: str) -> Path:
        return self.folder / "calibration" / name

    def _read_rows(self) -> dict[str, tuple[Matrix, tuple[int, int]]]:
        """Return K (3, 3) and (height, width) by camera."""
        path = self._calibration(INTRINSICS)
        table = read_feather(path, ("sensor_name", *K_COLUMNS))
        rows = {}
        for name, *numbers in zip(*(table[column] for column in ("sensor_name", *K_COLUMNS)), strict=True):
            fx, fy, cx, cy, width, height = map(float, numbers)
            if not (np.isfinite(numbers).all() and min(fx, fy, width, height) > 0):
                raise DataError(
                    f"{path}: {name} is no pinhole camera (fx {fx:g}, {width:g}x{height:g}): download it again"
                )
            rows[str(name)] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), (int(height), int(width))
        return rows

    def _read_cameras(self) -> tuple[RectifiedCamera, RectifiedCamera | None]:
        """Return this camera and its partner; sets the baseline."""
        names = [self.camera_name, *([self.partner] if self.partner_images and self.partner else [])]
        lacking = [name for name in names if name not in self._rows]
        if lacking:
            raise DataError(f"{self._calibration(INTRINSICS)}: no camera {lacking[0]}: download the log again")
        places = self._read_places()
        if len(names) == 1:
            K, size = self._rows[self.camera_name]
            return RectifiedCamera(Camera(K, size), places[self.camera_name]), None
        K_pair, sizes = zip(*(self._rows[name] for name in PAIR), strict=True)
        cameras, baseline_m = rectify_pair(K_pair, [places[name] for name in PAIR], sizes[0])
        self.baseline_m = check_baseline(baseline_m, f"from {PAIR[0]} to {PAIR[1]}", self._calibration(PLACES))
        return cameras if self.side == "left" else cameras[::-1]

    def _read_places(self) -> dict[str, Matrix]:
        """Return T_ego_sensor (4, 4) by sensor."""
        path = self._calibration(PLACES)
        table = read_feather(path, ("sensor_name", *QUATERNION, *TRANSLATION))
        rows = zip(table["sensor_name"], *(table[c] for c in (*QUATERNION, *TRANSLATION)), strict=True)
        places = {str(name): to_pose(row[:4], row[4:], f"{path}: {name}") for name, *row in rows}
        needed = [self.camera_name, *([self.partner] if self.partner_images and self.partner else [])]
        lacking = [name for name in needed if name not in places]
        if lacking:
            raise DataError(f"{path}: no sensor {lacking[0]}: download the log again")
        return places

    def _read_poses(self) -> tuple[list[int], npt.NDArray[np.float64]]:
        """Return times in ns, sorted, and their rows qw qx qy qz tx ty tz; nothing without the file."""
        path = self.folder / POSES
        if not path.is_file():
            return [], np.zeros((0, 7))
        table = read_feather(path, ("timestamp_ns", *QUATERNION, *TRANSLATION))
        times = table["timestamp_ns"].astype(np.int64)
        order = np.argsort(times, kind="stable")
        rows = np.stack([table[column].astype(np.float64) for column in (*QUATERNION, *TRANSLATION)], axis=1)
        return times[order].tolist(), rows[order]

    def _pose(self, index: int) -> Matrix:
        row = self._poses[index].tolist()
        return to_pose(row[:4], row[4:], f"{self.folder / POSES}: pose at {self._pose_times[index]}")
