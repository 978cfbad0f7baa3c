"""KITTI raw: date folders with drive folders in them, as downloaded ("synced+rectified").

    2011_09_26/calib_{cam_to_cam,velo_to_cam,imu_to_velo}.txt
    2011_09_26/2011_09_26_drive_0001_sync/{image_00..03,velodyne_points,oxts}/{data/,timestamps.txt}

Quirks kept here:
- Everything is joined by frame id: drives miss scans, images may cover fewer frames than the LiDAR.
- image_02 is not camera 0: each P_rect has its own offset, and the sweep goes through camera 0's rectification.
- Poses come from oxts in metres. The world is the IMU's frame at the first oxts file (x forward, y left, z up).
- The oxts record kept for a frame was taken up to 5 ms before or after it: _oxts.py interpolates.
- A sweep is one turn of the scanner, not a moment: the cameras are triggered when it faces forward, what lies to the
  left was measured up to 50 ms before that, to the right after it.
- Pixel centres are integers: with the two facts above our projection repeats the official `velodyne_raw` maps
  (99.99 % of the common pixels within 2 cm on drive 0001; tests/test_kitti_raw.py).
- The depth maps (`groundtruth`, `velodyne_raw`) are other downloads: looked for beside, or under --truth.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors import codecs
from priors.drives import DriveOptions, _kitti_maps
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_baseline,
    check_size,
    choose,
    digest,
    follow,
    need,
    read_key_values,
    read_sized,
    read_times,
    search,
    split_projection,
    stems,
)
from priors.drives._oxts import Track
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.geometry import invert
from priors.types import Camera, Depth, Frame, Matrix, Sweep

SWEEP_S = 0.1
# The scanner turns clockwise seen from above: azimuth (x forward, y left) falls as time passes.
SECONDS_PER_RADIAN = -SWEEP_S / (2 * np.pi)
# Frames built in order share sweeps: 11 accumulated, and some workers ahead. 2 MB each.
SWEEPS_KEPT = 24
PARTNER = {"image_00": "image_01", "image_01": "image_00", "image_02": "image_03", "image_03": "image_02"}
DATES = ("2011_09_26", "2011_09_28", "2011_09_29", "2011_09_30", "2011_10_03")
"""Of KITTI's own recordings; others use its layout."""


def recognises(path: Path) -> bool:
    """Tell whether the folder is a drive, a date or a folder of dates."""
    return bool(_drive_folders(path))


def open_drive(path: Path, options: DriveOptions) -> "KittiRaw":
    """Open one drive; path is the drive's folder, or a parent of it with options.drive."""
    folder = choose(_drive_folders(path), options.drive, path, "a drive's folder (image_02/data, velodyne_points/data)")
    with_images = [name for name in ("image_02", "image_00", "image_03", "image_01") if _images(folder, name)]
    return KittiRaw(folder, options.camera or next(iter(with_images), "image_02"), options.truth)


def _drive_folders(path: Path) -> list[Path]:
    """List the drives at path, or where it is none itself, one or two levels below."""
    return search(path, lambda folder: any((folder / name / "data").is_dir() for name in PARTNER), 2)


@dataclass(frozen=True)
class Calibration:
    """What a date's three files say about one camera of the rig."""

    camera: Camera
    T_cam_cam0: Matrix
    T_cam0_velo: Matrix | None
    T_velo_imu: Matrix | None


class KittiRaw:
    """One camera's view of one drive."""

    def __init__(self, folder: Path, camera: str = "image_02", truth: Path | None = None) -> None:
        self.folder, self.camera_name = folder, camera
        if camera not in PARTNER:
            raise DataError(f"{folder}: no camera {camera!r}: choose one of {', '.join(PARTNER)}")
        self._images = _images(folder, camera)
        if not self._images:
            raise DataError(f"{folder / camera / 'data'}: no PNG or JPEG images: download the drive's synced data")
        self._others = _images(folder, PARTNER[camera])
        self._sweeps = stems(follow(folder / "velodyne_points") / "data", [".bin"])
        self._track = Track(follow(folder / "oxts"))
        self.ids = list(self._images)
        self.calibration = read_calibration(folder.parent, camera)
        self.baseline_m, self.side = self._read_pair()
        self._read_sweep = lru_cache(maxsize=SWEEPS_KEPT)(self._load_sweep)
        self._truth_option = truth
        self._maps = self._find_maps()

    @property
    def name(self) -> str:
        """Drive folder's name; cameras other than the usual one are named too."""
        return self.folder.name if self.camera_name == "image_02" else f"{self.folder.name}-{self.camera_name}"

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records and `open_drive` needs."""
        truth = None if self._truth_option is None else str(Path(self._truth_option).resolve())
        path = str(self.folder.resolve())
        return {"dataset": "kitti_raw", "path": path, "camera": self.camera_name, "truth": truth}

    def fingerprint(self) -> str:
        """Digest calibration, oxts and the first image."""
        calibration = sorted(self.folder.parent.glob("calib_*.txt"))
        return digest([*calibration, *self._track.sources, next(iter(self._images.values()))])

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids each sensor has, for the audit."""
        return {"other": list(self._others), "sweep": list(self._sweeps), "oxts": list(self._track.files)}

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        id_ = self.ids[index]
        camera = self.calibration.camera
        sources: dict[str, Any] = {"image": partial(read_sized, self._images[id_], camera)}
        missing = {
            "other": f"no image {PARTNER[self.camera_name]}/data/{id_} in {self.folder}: stereo needs both cameras",
            "sweep": f"no sweeps in {self.folder / 'velodyne_points' / 'data'}: download the velodyne data",
            **self._lacking_maps,
            "sky": f"no sky masks beside {self.folder.name}: KITTI has none, the embedded street has",
        }
        if id_ in self._others:
            sources["other"] = partial(read_sized, self._others[id_], camera)
        if self._sweeps and self.calibration.T_cam0_velo is not None:
            sources["sweep"] = lambda offset=0: self._read_sweep(int(id_) + offset, len(id_))
        if id_ in self._skies:
            sources["sky"] = lambda: read_sized(self._skies[id_], camera) > 127
        for what, kind in (("truth", "groundtruth"), ("sparse", "velodyne_raw")):
            if id_ in self._maps[kind]:
                sources[what] = partial(self._read_map, self._maps[kind][id_])
        return Frame(
            id=id_,
            camera=camera,
            readers=sources,
            missing=missing,
            T_world_cam=self._pose(id_),
            T_cam_lidar=self._T_cam_velo,
            time_s=self._times.get(int(id_)),
            baseline_m=self.baseline_m,
            rig=KITTI if self.folder.name.startswith(DATES) else None,
            side=self.side,
        )

    @cached_property
    def _skies(self) -> dict[str, Path]:
        """Map frame id to sky mask (255 = sky); only the embedded street has them."""
        return stems(self.folder / "sky" / self.camera_name / "data", [".png"])

    @cached_property
    def _T_cam_velo(self) -> Matrix | None:
        T_cam0_velo = self.calibration.T_cam0_velo
        return None if T_cam0_velo is None else self.calibration.T_cam_cam0 @ T_cam0_velo

    @cached_property
    def _times(self) -> dict[int, float]:
        """Camera times by frame number; the file counts frames from 0, whichever images were kept."""
        path = self.folder / self.camera_name / "timestamps.txt"
        return read_times(path) if path.exists() else {}

    def _read_pair(self) -> tuple[float | None, Any]:
        side = "left" if self.camera_name in ("image_00", "image_02") else "right"
        if not self._others:
            return None, side
        partner = read_calibration(self.folder.parent, PARTNER[self.camera_name])
        offset_m = float(self.calibration.T_cam_cam0[0, 3] - partner.T_cam_cam0[0, 3])
        baseline_m = offset_m if side == "left" else -offset_m
        path = self.folder.parent / "calib_cam_to_cam.txt"
        return check_baseline(baseline_m, f"from {self.camera_name} to {PARTNER[self.camera_name]}", path), side

    def _read_map(self, path: Path) -> Depth:
        return Depth(check_size(codecs.read_depth_png(path), path, self.calibration.camera))

    def _find_maps(self) -> dict[str, dict[str, Path]]:
        """Find the drive's depth maps by kind and frame id."""
        if self._truth_option is not None:
            return _kitti_maps.given(Path(self._truth_option), self.folder.name, self.camera_name)
        return _kitti_maps.beside(self._above, self.folder.name, self.camera_name, self.calibration.camera.size)

    @cached_property
    def _lacking_maps(self) -> dict[str, str]:
        """Say why there is no map, by what the frame would read it as."""
        reasons = {}
        for what, kind in (("truth", "groundtruth"), ("sparse", "velodyne_raw")):
            if self._maps[kind]:
                reasons[what] = f"{next(iter(self._maps[kind].values())).parent}: no map of this frame"
            else:
                reasons[what] = _kitti_maps.lacking(self._above, self.folder.name, self.camera_name, kind)
        return reasons

    @property
    def _above(self) -> list[Path]:
        return list(self.folder.absolute().parents)[:3]

    def _pose(self, id_: str) -> Matrix | None:
        """T_world_cam at a frame; None where the drive has no oxts for it."""
        T_world_velo = self._T_world_velo(id_)
        if T_world_velo is None or self._T_cam_velo is None:
            return None
        return T_world_velo @ invert(self._T_cam_velo)

    def _T_world_velo(self, id_: str) -> Matrix | None:
        T_velo_imu, T_world_imu = self.calibration.T_velo_imu, self._track.T_world_imu(id_)
        return None if T_velo_imu is None or T_world_imu is None else T_world_imu @ invert(T_velo_imu)

    def _load_sweep(self, number: int, width: int) -> Sweep | None:
        id_ = f"{number:0{width}d}"
        if id_ not in self._sweeps:
            return None
        xyz_m = read_sweep_file(self._sweeps[id_])
        velocity = self._velocity(number, width)
        time_s = None
        if velocity is not None:
            azimuth = np.arctan2(xyz_m[:, 1], xyz_m[:, 0])
            time_s = (SECONDS_PER_RADIAN * azimuth).astype(np.float32)
            time_s.flags.writeable = False
        xyz_m.flags.writeable = False  # sweeps are shared
        return Sweep(xyz_m, self._T_world_velo(id_), time_s, velocity)

    def _velocity(self, number: int, width: int) -> Matrix | None:
        """Ego motion (m/s, rad/s) in the LiDAR's frame, from the poses around the frame."""
        around = [(k, self._pose_or_none(f"{number + k:0{width}d}")) for k in (-1, 0, 1)]
        known = [(k, pose) for k, pose in around if pose is not None]
        if len(known) < 2:
            return None
        (first, T_world_a), (last, T_world_b) = known[0], known[-1]
        seconds = (last - first) * SWEEP_S
        T_a_b = invert(T_world_a) @ T_world_b
        return np.concatenate([T_a_b[:3, 3], Rotation.from_matrix(T_a_b[:3, :3]).as_rotvec()]) / seconds

    def _pose_or_none(self, id_: str) -> Matrix | None:
        """A neighbour's pose; a damaged one is as good as none here, and an error at its own frame."""
        try:
            return self._T_world_velo(id_)
        except DataError:
            return None


def _images(folder: Path, camera: str) -> dict[str, Path]:
    images = stems(follow(folder / camera) / "data", IMAGE_SUFFIXES)
    return {id_: path for id_, path in images.items() if id_.isdecimal()}


def read_calibration(date: Path, camera: str) -> Calibration:
    """Read a date's calibration files for one camera (image_00 .. image_03)."""
    path = date / "calib_cam_to_cam.txt"
    values = read_key_values(path)
    number = camera[-2:]
    P = need(values, f"P_rect_{number}", 12, path).reshape(3, 4)
    K, T_cam_cam0 = split_projection(P, f"P_rect_{number}", path)
    width, height = need(values, f"S_rect_{number}", 2, path)
    R_rect = np.eye(4)
    R_rect[:3, :3] = need(values, "R_rect_00", 9, path).reshape(3, 3)
    T_cam_velo = _read_rigid(date / "calib_velo_to_cam.txt")
    return Calibration(
        camera=Camera(K, (int(height), int(width))),
        T_cam_cam0=T_cam_cam0,
        T_cam0_velo=None if T_cam_velo is None else R_rect @ T_cam_velo,
        T_velo_imu=_read_rigid(date / "calib_imu_to_velo.txt"),
    )


def _read_rigid(path: Path) -> Matrix | None:
    """Read R and T as (4, 4); None where the file is not there (image-only downloads)."""
    if not path.exists():
        return None
    values = read_key_values(path)
    T_a_b = np.eye(4)
    T_a_b[:3, :3] = need(values, "R", 9, path).reshape(3, 3)
    T_a_b[:3, 3] = need(values, "T", 3, path)
    return T_a_b


def read_sweep_file(path: Path) -> npt.NDArray[np.float32]:
    """Read a velodyne .bin (float32 x y z reflectance): (n, 3) metres, points that are not finite left out."""
    try:
        size = path.stat().st_size
        data = np.fromfile(path, dtype="<f4")
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    if size % 16:
        raise DataError(f"{path}: {size} bytes are not whole points of 16 bytes: truncated, download it again")
    if size == 0:
        raise DataError(f"{path}: empty sweep: download it again, or leave the frame out with --frames")
    xyz_m = np.ascontiguousarray(data.reshape(-1, 4)[:, :3])
    finite = np.isfinite(xyz_m).all(axis=1)
    if not finite.any():
        raise DataError(f"{path}: no finite point in the sweep: download it again")
    return xyz_m if finite.all() else xyz_m[finite]
