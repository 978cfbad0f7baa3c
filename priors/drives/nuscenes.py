"""nuScenes: scenes of 20 seconds, six cameras around and a LiDAR, as downloaded.

    v1.0-mini/{scene,sample,sample_data,ego_pose,calibrated_sensor,sensor}.json
    samples/CAM_FRONT/<log>__CAM_FRONT__1532402927612460.jpg     keyframes, 2 Hz
    sweeps/CAM_FRONT/...                                         the frames between them: 12 Hz, LiDAR 20 Hz
    samples/LIDAR_TOP/<log>__LIDAR_TOP__1532402927647951.pcd.bin

Quirks kept here (those of the tables in _nuscenes_tables.py):
- A drive is a scene, by its name (scene-0061): --drive. The folder holds all of them.
- Frame ids are the images' microseconds: keyframes and those between. Files that were not downloaded are left out.
- An image takes the sweep nearest in time, at most 51 ms away; sweep(k) counts sweeps from there. Each file has an ego
  pose of its own, so the vehicle's motion between image and sweep is accounted for.
- Images are undistorted already. No two cameras are a stereo pair.
- A sweep's points have five numbers, x y z intensity ring, in the LiDAR's frame (x right, y forward, z up). They are
  not compensated for the motion during the turn, and their times are not known.
- The world is the map's frame, metres. ego_pose has no height: z is 0 along the whole drive.
"""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.drives import DriveOptions
from priors.drives._files import revise
from priors.drives._nuscenes_tables import Tables, Taken, versions
from priors.drives._points import only_points
from priors.drives._rectified import RectifiedCamera
from priors.drives._timed_drive import TimedDrive
from priors.errors import DataError, UsageError
from priors.types import Camera, Matrix

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
LIDAR = "LIDAR_TOP"
BYTES = 20
"""Of a point."""


def recognises(path: Path) -> bool:
    """Tell whether the folder has tables of a version, v1.0-mini say."""
    return bool(versions(path))


def open_drive(path: Path, options: DriveOptions) -> "NuScenes":
    """Open one scene; path is the data set's folder."""
    if options.truth is not None:
        raise UsageError(f"{path}: nuScenes has no depth maps: leave --truth out")
    if options.camera not in (None, *CAMERAS):
        raise UsageError(f"{path}: no camera {options.camera!r}: choose one of {', '.join(CAMERAS)}")
    tables = [Tables(folder) for folder in versions(path)]
    if not tables:
        raise DataError(f"{path}: no tables such as v1.0-mini/sample_data.json in it: unpack the metadata there")
    scenes = {name: of for of in reversed(tables) for name in of.scenes}
    some = ", ".join(sorted(scenes)[:3]) + (", ..." if len(scenes) > 3 else "")
    if options.drive is not None and options.drive not in scenes:
        raise UsageError(f"{path}: no drive {options.drive!r} in it: found {some}")
    if options.drive is None and len(scenes) != 1:
        raise UsageError(f"{path}: holds {len(scenes)} drives: choose with --drive {min(scenes)} (found {some})")
    scene = options.drive or next(iter(scenes))
    return NuScenes(path, scenes[scene], scene, options.camera or CAMERAS[0])


class NuScenes(TimedDrive):
    """One camera's view of one scene."""

    usual_camera = CAMERAS[0]
    tick_s, near_sweep, near_other = 1e-6, 51_000, 0

    def __init__(self, folder: Path, tables: Tables, scene: str, camera: str) -> None:
        super().__init__(folder, camera)
        self._tables, self.scene = tables, scene
        taken = tables.taken(tables.scenes[scene])
        images, sweeps = self._there(taken.get(camera, [])), self._there(taken.get(LIDAR, []))
        if not images:
            listed = len(taken.get(camera, []))
            raise DataError(
                f"{self.folder}: none of the {listed} images of {camera} of {scene} is there: download its blob"
            )
        self._taken = {each.time_us: each for each in (*sweeps, *images)}
        self.images = {str(each.time_us): self.folder / each.file for each in images}
        self.sweeps = {each.time_us: self.folder / each.file for each in sweeps}
        self.partner_images, self.partner_rectified = {}, None
        sensor = images[0].calibrated_sensor
        self.rectified = RectifiedCamera(Camera(tables.K(sensor), images[0].size), tables.T_ego_sensor(sensor))
        self.camera = self.rectified.camera
        self.T_ego_lidar = tables.T_ego_sensor(sweeps[0].calibrated_sensor) if sweeps else np.eye(4)

    @property
    def name(self) -> str:
        """The data set and the scene, and the camera unless it looks ahead."""
        named = f"nuscenes_{self.scene}"
        return named if self.camera_name == self.usual_camera else f"{named}-{self.camera_name}"

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: also the scene."""
        return {**super().describe(), "drive": self.scene}

    def fingerprint(self) -> str:
        """Digest the first image and what places all of them."""
        placed = [self.camera.K.tolist(), self.T_ego_lidar.tolist()]
        poses = [np.round(T, 9).tolist() for id_ in self.ids if (T := self.T_world_cam(id_)) is not None]
        return revise(super().fingerprint(), self.scene, repr(placed), repr(poses))

    def sources(self) -> list[Path]:
        """List no file: tables are of all scenes, and what they say of this one is in the fingerprint."""
        return []

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        truth = "nuScenes has no depth maps: score against the LiDAR (`priors eval --against`)"
        return {
            "other": "nuScenes' cameras are no stereo pairs: use completion of its LiDAR, or mono",
            "sweep": f"{self.folder / 'samples' / LIDAR}: no sweeps of {self.scene}: download its lidar blob",
            "truth": truth,
            "sparse": "nuScenes has no sparse depth maps: use --completion.source lidar",
            "sky": "nuScenes has no sky masks",
        }

    def T_world_ego(self, time: int) -> Matrix | None:
        """Return the vehicle's pose at the time of an image or a sweep."""
        if time not in self._poses and time in self._taken:
            self._poses[time] = self._tables.T_world_ego(self._taken[time].ego_pose)
        return self._poses.get(time)

    def read_points(self, path: Path) -> npt.NDArray[np.float32]:
        """Read a sweep's points (n, 3), metres; values that no scanner measures are left out."""
        data = codecs.read_bytes(path)
        if len(data) % BYTES or not data:
            told = "empty sweep" if not data else f"{len(data)} bytes are not whole points of {BYTES} bytes: truncated"
            raise DataError(f"{path}: {told}: download it again, or leave the frame out with --frames")
        xyz_m = np.ascontiguousarray(np.frombuffer(data, "<f4").reshape(-1, 5)[:, :3])
        return xyz_m[only_points(xyz_m, path, "little-endian float32 x y z intensity ring")]

    @cached_property
    def _poses(self) -> dict[int, Matrix]:
        return {}

    def _there(self, taken: list[Taken]) -> list[Taken]:
        """Return what was downloaded."""
        return [each for each in taken if (self.folder / each.file).is_file()]
