"""Argoverse 1: tracking logs, and logs of the rectified stereo release, as downloaded.

    argoverse-tracking/<split>/<log>/{ring_*,stereo_front_left,stereo_front_right}/<camera>_<ns>.jpg
                                    /lidar/PC_<ns>.ply   /poses/city_SE3_egovehicle_<ns>.json
                                    /vehicle_calibration_info.json
    rectified_stereo_images_v1.1/<split>/<log>/stereo_front_{left,right}_rect/<camera>_<ns>.jpg
                                              /vehicle_calibration_stereo_info.json
    disparity_maps_v1.1/<split>/<log>/stereo_front_left_rect_disparity/disparity_<ns>.png

Quirks kept here (those of the calibration in _argoverse1_calibration.py):
- Frame ids are the image's nanoseconds. Ring cameras run at 30 Hz, the stereo pair at 5 Hz, the LiDAR at 10 Hz: an
  image takes the sweep nearest in time, at most 51 ms away, and sweep(k) counts sweeps from there, not images.
- Sweeps are in the vehicle's frame and motion compensated to their own time. The vehicle moves between sweep and image:
  a frame's T_cam_lidar accounts for that where there are poses, so it differs from frame to frame.
- Poses are T_city_vehicle at the sensors' times; between two of them they are interpolated.
- A stereo release's log has no sweeps and poses of its own: those of the tracking log of the same name are used when
  argoverse-tracking lies beside.
- Disparity maps are uint16, px x 256, 0 = none, of the left rectified camera.
"""

from bisect import bisect_left
from functools import cached_property, partial
from glob import escape
from pathlib import Path

from priors import codecs
from priors.drives import CameraDrive, DriveOptions
from priors.drives._argoverse1_calibration import LogCalibration
from priors.drives._by_time import beside, between, by_time, nearest
from priors.drives._camera_drive import Files, Readers
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_size,
    choose,
    follow,
    read_sized,
    search,
)
from priors.drives._links import homes
from priors.drives._ply import read_ply
from priors.drives._rectified import RectifiedCamera, to_pose
from priors.errors import DataError
from priors.geometry import convert_disparity, invert
from priors.motion import Trajectory
from priors.poses import readable
from priors.text import read_json
from priors.types import Depth, Image, Matrix, Sweep

BELOW = 3
"""How many levels below a folder its logs may be: a release, a split, then a log."""
TRACKING, STEREO = "vehicle_calibration_info.json", "vehicle_calibration_stereo_info.json"
PAIR = ("stereo_front_left", "stereo_front_right")
PAIR_RECT = ("stereo_front_left_rect", "stereo_front_right_rect")
DEFAULTS = (*PAIR_RECT, *PAIR, "ring_front_center")
NEAR_SWEEP_NS = 51_000_000  # half a turn of the LiDAR, and 1 ms for the message to arrive
NEAR_OTHER_NS = 10_000_000  # the pair is triggered together
POSE_GAP_NS = 200_000_000  # poses farther apart are not interpolated


def recognises(path: Path) -> bool:
    """Tell whether the folder is a log, or holds logs up to three levels below."""
    return bool(search(path, is_drive, BELOW))


def open_drive(path: Path, options: DriveOptions) -> "Argoverse1":
    """Open one log; path is its folder, or a parent of it with options.drive."""
    return Argoverse1(choose(search(path, is_drive, BELOW), options.drive, path, f"a log ({TRACKING})"), options)


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a log."""
    return (folder / TRACKING).is_file() or (folder / STEREO).is_file()


class Argoverse1(CameraDrive):
    """One camera's view of one log."""

    pairs = (PAIR, PAIR_RECT)

    def __init__(self, folder: Path, options: DriveOptions) -> None:
        camera = options.camera or next((c for c in DEFAULTS if (folder / c).is_dir()), DEFAULTS[-1])
        super().__init__(folder, camera, options.truth)
        self._homes = homes(self.folder, follow(self.folder / camera))
        images = by_time(follow(self.folder / camera), IMAGE_SUFFIXES)
        if not images:
            cameras = sorted(p.name for p in folder.iterdir() if p.name.startswith(("ring_", "stereo_")))
            raise DataError(f"{folder / camera}: no images: choose a --camera (found {', '.join(cameras) or 'none'})")
        self.images, self._times = {str(time): path for time, path in images.items()}, list(images)
        self._partner_images = by_time(follow(self.folder / self.partner), IMAGE_SUFFIXES) if self.partner else {}
        self._calibration_file = self.folder / (STEREO if camera in PAIR_RECT else TRACKING)
        self._rectified, self._partner_rectified, self.baseline_m = self._read_cameras()
        self.camera = self._rectified.camera
        log = self._companion()
        self._sweeps = by_time(follow(log / "lidar"), [".ply"])
        self._poses = by_time(follow(log / "poses"), [".json"])
        self._partner_times, self._sweep_times = list(self._partner_images), list(self._sweeps)
        self._pose_times = list(self._poses)
        self._disparities = self._find_disparities()

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        return [self._calibration_file, *self._poses.values()]

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that have a partner and a sweep near enough in time, and truth, for the audit."""
        return {
            "other": [
                str(time) for time in self._times if nearest(self._partner_times, time, NEAR_OTHER_NS) is not None
            ],
            "sweep": [str(time) for time in self._times if nearest(self._sweep_times, time, NEAR_SWEEP_NS) is not None],
            "truth": [str(time) for time in self._disparities],
        }

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame; images are rectified, what is near in time belongs to the frame."""
        time = int(id_)
        readers: Readers = {"image": partial(_read_rectified, self.images[id_], self._rectified)}
        other = nearest(self._partner_times, time, NEAR_OTHER_NS)
        if other is not None and self._partner_rectified is not None:
            readers["other"] = partial(_read_rectified, self._partner_images[other], self._partner_rectified)
        if self._sweeps and self._rectified.T_ego_cam is not None:
            readers["sweep"] = lambda offset=0: self._read_sweep(time, offset)
        if time in self._disparities:
            readers["truth"] = partial(self.read_map, self._disparities[time], id_)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads."""
        time = int(id_)
        other = nearest(self._partner_times, time, NEAR_OTHER_NS)
        return {
            "image": partial(self.images.get, id_),
            "other": lambda: None if other is None else self._partner_images[other],
            "sweep": lambda offset=0: self._sweep_file(time, offset),
            "truth": partial(self._disparities.get, time),
        }

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read a disparity map as depth."""
        disparity_px = check_size(codecs.read_depth_png(path), path, self.camera)
        if self.baseline_m is None:
            raise DataError(f"{path}: disparity without a baseline: choose a --camera of the pair")
        return Depth(convert_disparity(disparity_px, self.camera.fx, self.baseline_m))

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the camera's pose; None without poses around the image's time, or a place on the vehicle."""
        T_world_ego, T_ego_cam = self._T_world_ego(int(id_)), self._rectified.T_ego_cam
        return None if T_world_ego is None or T_ego_cam is None else T_world_ego @ T_ego_cam

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Map the nearest sweep, at its own time, into the camera at the image's time."""
        if self._rectified.T_ego_cam is None:
            return None
        T_cam_ego, T_world_ego = invert(self._rectified.T_ego_cam), self._T_world_ego(int(id_))
        sweep = nearest(self._sweep_times, int(id_), NEAR_SWEEP_NS)
        T_world_lidar = None if sweep is None else self._T_world_ego(sweep)
        if T_world_ego is None or T_world_lidar is None:
            return T_cam_ego
        return T_cam_ego @ invert(T_world_ego) @ T_world_lidar

    def time_s(self, id_: str) -> float:
        """Return seconds since the log's first image."""
        return (int(id_) - self._times[0]) * 1e-9

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        other = "ring cameras have no partner: stereo needs --camera stereo_front_left"
        if self.partner is not None:
            other = f"{self.folder / self.partner}: no image within 10 ms of {id_}: stereo needs both cameras"
        sweep = f"{self.folder}: no lidar/PC_*.ply: put argoverse-tracking beside the stereo release"
        if self._sweeps:
            sweep = f"{self._calibration_file}: no {PAIR_RECT[0]}_refined: the camera's place on the car is unknown"
        truth = f"no {PAIR_RECT[0]}_disparity map of {id_} in disparity_maps_v1.1, beside or under --truth"
        if self.camera_name != PAIR_RECT[0]:
            truth = f"disparity truth is for {PAIR_RECT[0]} of the rectified stereo release, not for {self.camera_name}"
        sparse = "Argoverse has no sparse depth maps: use --completion.source lidar"
        return {"other": other, "sweep": sweep, "truth": truth, "sparse": sparse, "sky": "Argoverse has no sky masks"}

    def _read_cameras(self) -> tuple[RectifiedCamera, RectifiedCamera | None, float | None]:
        """Read this camera, its partner and their baseline."""
        calibration = LogCalibration(self._calibration_file)
        if self.partner is None:
            return calibration.ring_camera(self.camera_name), None, None
        if self.camera_name in PAIR:
            left, right, baseline_m = calibration.rectify_pair(*PAIR)
        else:
            left, right, baseline_m = calibration.rectified_pair(*PAIR_RECT)
        return (left, right, baseline_m) if self.side == "left" else (right, left, baseline_m)

    def _companion(self) -> Path:
        """Return the folder with sweeps and poses: this log's, or the tracking log of the same name."""
        for home in self._homes:
            if (home / "poses").exists() or (home / "lidar").exists():
                return home
        for home in self._homes:
            for above in list(home.parents)[1:4]:
                logs = sorted(above.glob(f"argoverse-tracking/*/{escape(home.name)}"))
                if logs:
                    return logs[0]
        return self.folder

    def _T_world_ego(self, time: int) -> Matrix | None:
        """Return the vehicle's pose at a time in ns: stored, or interpolated between the poses around; else None."""
        after = bisect_left(self._pose_times, time)
        around = self._pose_times[max(after - 1, 0) : after + 1]
        if time in around:
            return _read_pose(self._poses[time])
        if len(around) < 2 or not around[0] < time < around[1] or around[1] - around[0] > POSE_GAP_NS:
            return None
        T_world_a, T_world_b = (_read_pose(self._poses[t]) for t in around)
        return between(T_world_a, T_world_b, (time - around[0]) / (around[1] - around[0]))

    def _sweep_time(self, time: int, offset: int) -> int | None:
        """Return the time of the sweep that lies `offset` sweeps from the one nearest to an image; None without one."""
        return beside(self._sweep_times, time, NEAR_SWEEP_NS, offset)

    def _sweep_file(self, time: int, offset: int) -> Path | None:
        sweep = self._sweep_time(time, offset)
        return None if sweep is None else self._sweeps[sweep]

    def _read_sweep(self, time: int, offset: int) -> Sweep | None:
        sweep = self._sweep_time(time, offset)
        if sweep is None:
            return None
        placed = Sweep(read_ply(self._sweeps[sweep]), self._T_world_ego(sweep))
        return self._path.without_far_side(placed, str(self._sweep_time(time, 0)), str(sweep))

    @cached_property
    def _path(self) -> Trajectory:
        """The vehicle's trajectory at the sweeps, by their nanoseconds; damaged poses are left out."""
        poses = readable(self._sweep_times, self._T_world_ego)
        return Trajectory.of_numbers(poses, {time: time * 1e-9 for time in poses})

    def _find_disparities(self) -> dict[int, Path]:
        if self.camera_name != PAIR_RECT[0]:
            return {}
        for home in self._homes:
            split, inside = home.parent.name, f"{home.name}/{PAIR_RECT[0]}_disparity"
            roots = [above / "disparity_maps_v1.1" / split for above in list(home.parents)[2:3]]
            if self.truth is not None:
                roots = [self.truth / "disparity_maps_v1.1" / split, self.truth / split, self.truth]
            for root in roots:
                maps = by_time(root / inside, [".png"])
                if maps:
                    return maps
        if self.truth is None:
            return {}
        wanted = f"disparity_maps_v1.1/{self.folder.parent.name}/{self.folder.name}/{PAIR_RECT[0]}_disparity"
        raise DataError(f"{self.truth}: --truth should hold {wanted}, found none")


def _read_pose(path: Path) -> Matrix:
    data = read_json(path)
    return to_pose(data.get("rotation"), data.get("translation"), str(path))


def _read_rectified(path: Path, camera: RectifiedCamera) -> Image:
    return camera.rectify(read_sized(path, camera.camera))
