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

from glob import escape
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.drives import DriveOptions
from priors.drives._argoverse1_calibration import LogCalibration
from priors.drives._by_time import at_time, by_time
from priors.drives._files import IMAGE_SUFFIXES, check_size, choose, follow, search
from priors.drives._links import homes
from priors.drives._ply import read_ply
from priors.drives._rectified import RectifiedCamera, to_pose
from priors.drives._timed_drive import TimedDrive
from priors.errors import DataError
from priors.geometry import convert_disparity
from priors.text import read_json
from priors.types import Depth, Matrix

BELOW = 3
"""How many levels below a folder its logs may be: a release, a split, then a log."""
TRACKING, STEREO = "vehicle_calibration_info.json", "vehicle_calibration_stereo_info.json"
PAIR = ("stereo_front_left", "stereo_front_right")
PAIR_RECT = ("stereo_front_left_rect", "stereo_front_right_rect")
DEFAULTS = (*PAIR_RECT, *PAIR, "ring_front_center")
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


class Argoverse1(TimedDrive):
    """One camera's view of one log."""

    pairs = (PAIR, PAIR_RECT)
    tick_s = 1e-9
    near_sweep = 51_000_000  # half a turn of the LiDAR, and 1 ms for the message to arrive
    near_other = 10_000_000  # the pair is triggered together

    def __init__(self, folder: Path, options: DriveOptions) -> None:
        camera = options.camera or next((c for c in DEFAULTS if (folder / c).is_dir()), DEFAULTS[-1])
        super().__init__(folder, camera, options.truth)
        self._homes = homes(self.folder, follow(self.folder / camera))
        images = by_time(follow(self.folder / camera), IMAGE_SUFFIXES)
        if not images:
            cameras = sorted(p.name for p in folder.iterdir() if p.name.startswith(("ring_", "stereo_")))
            raise DataError(f"{folder / camera}: no images: choose a --camera (found {', '.join(cameras) or 'none'})")
        self.images = {str(time): path for time, path in images.items()}
        self.partner_images = by_time(follow(self.folder / self.partner), IMAGE_SUFFIXES) if self.partner else {}
        self._calibration_file = self.folder / (STEREO if camera in PAIR_RECT else TRACKING)
        self.rectified, self.partner_rectified, self.baseline_m = self._read_cameras()
        self.camera = self.rectified.camera
        log = self._companion()
        self.sweeps, self.T_ego_lidar = by_time(follow(log / "lidar"), [".ply"]), np.eye(4)
        self._poses = by_time(follow(log / "poses"), [".json"])
        self._pose_times = list(self._poses)
        self.maps = {"truth": {str(time): path for time, path in self._find_disparities().items()}}

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        return [self._calibration_file, *self._poses.values()]

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read a disparity map as depth."""
        disparity_px = check_size(codecs.read_depth_png(path), path, self.camera)
        if self.baseline_m is None:
            raise DataError(f"{path}: disparity without a baseline: choose a --camera of the pair")
        return Depth(convert_disparity(disparity_px, self.camera.fx, self.baseline_m))

    def T_world_ego(self, time: int) -> Matrix | None:
        """Return the vehicle's pose at a time in ns: stored, or interpolated between the poses around; else None."""
        return at_time(self._pose_times, self._pose, time, POSE_GAP_NS)

    def read_points(self, path: Path) -> npt.NDArray[np.float32]:
        """Read a sweep's points (n, 3), metres."""
        return read_ply(path)

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        other = "ring cameras have no partner: stereo needs --camera stereo_front_left"
        if self.partner is not None:
            other = f"{self.folder / self.partner}: no image within 10 ms of {id_}: stereo needs both: download it"
        sweep = f"{self.folder}: no lidar/PC_*.ply: put argoverse-tracking beside the stereo release"
        if self.sweeps:
            sweep = f"{self._calibration_file}: no {PAIR_RECT[0]}_refined: the camera's place on the car is unknown"
        truth = f"no {PAIR_RECT[0]}_disparity map of {id_} in disparity_maps_v1.1: put it beside, or use --truth"
        if self.camera_name != PAIR_RECT[0]:
            truth = f"disparity truth is for {PAIR_RECT[0]} of the rectified stereo release, not for {self.camera_name}"
        sparse = "Argoverse has no sparse depth maps: use --completion.source lidar"
        poses = f"no poses/city_SE3_egovehicle_*.json around {id_}: put argoverse-tracking beside, or leave it out"
        return {
            "poses": poses,
            "other": other,
            "sweep": sweep,
            "truth": truth,
            "sparse": sparse,
            "sky": "Argoverse has no sky masks",
        }

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

    def _pose(self, index: int) -> Matrix:
        path = self._poses[self._pose_times[index]]
        data = read_json(path)
        return to_pose(data.get("rotation"), data.get("translation"), str(path))

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
