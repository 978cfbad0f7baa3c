"""KITTI-360: long suburban drives by another car, as downloaded.

    calibration/{perspective.txt, calib_cam_to_pose.txt, calib_cam_to_velo.txt}
    data_2d_raw/2013_05_28_drive_0000_sync/{image_00,image_01}/data_rect/0000000250.png, timestamps.txt
    data_3d_raw/2013_05_28_drive_0000_sync/velodyne_points/data/0000000250.bin
    data_poses/2013_05_28_drive_0000_sync/{poses.txt, cam0_to_world.txt}

Quirks kept here (the data set's documentation, and kitti360scripts' project.py):
- Each kind of data is a tree of its own, with the sequence's name in it; the drive is the folder in data_2d_raw.
- A line of poses.txt begins with its frame's number. Frames in which the car stood still have no line, so no pose.
- poses.txt is the IMU's. A camera's pose goes through calib_cam_to_pose, and back through its rectification R_rect.
  cam0_to_world.txt holds the left camera's, rectified, and is read where poses.txt is not there.
- calib_cam_to_velo.txt maps the unrectified camera 0 to the LiDAR.
- Sweeps are turns of the scanner, as those of KITTI raw: points carry their times, methods untwist them.
- image_02 and image_03 are fish-eyes, which nothing here reads.
"""

from functools import cached_property
from pathlib import Path

import numpy as np

from priors.drives import DriveOptions
from priors.drives._files import (
    IMAGE_SUFFIXES,
    choose,
    follow,
    need,
    read_key_values,
    read_times,
    search,
    split_projection,
    stems,
)
from priors.drives._links import homes
from priors.drives._numbered_drive import NumberedDrive
from priors.errors import DataError, UsageError
from priors.frame_ids import joined
from priors.geometry import invert
from priors.motion import Trajectory
from priors.poses import parse_pose, readable
from priors.text import Line, read_lines
from priors.types import Camera, Matrix

BELOW = 2
"""How many levels below the data set's own folder its drives are: data_2d_raw/, then a sequence."""
CAMERAS = ("image_00", "image_01")
FISH_EYES = ("image_02", "image_03")
DOWNLOAD = {
    "perspective.txt": "download calibration.zip",
    "calib_cam_to_pose.txt": "download calibration.zip",
    "calib_cam_to_velo.txt": "download calibration.zip",
}


def recognises(path: Path) -> bool:
    """Tell whether the folder is a drive, or holds drives."""
    return bool(search(path, is_drive, BELOW))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a sequence's in data_2d_raw."""
    return any((folder / name / "data_rect").is_dir() for name in CAMERAS)


def open_drive(path: Path, options: DriveOptions) -> "Kitti360":
    """Open one drive; path is its folder in data_2d_raw, or a parent of it with options.drive."""
    if options.truth is not None:
        raise UsageError(f"{path}: KITTI-360 has no depth maps: leave --truth out")
    if options.camera in FISH_EYES:
        raise UsageError(
            f"{path}: {options.camera} is a fish-eye, which is not read: choose one of {', '.join(CAMERAS)}"
        )
    folder = choose(
        search(path, is_drive, BELOW), options.drive, path, "a drive (data_2d_raw/DRIVE/image_00/data_rect)"
    )
    return Kitti360(folder, options.camera or next(name for name in CAMERAS if (folder / name / "data_rect").is_dir()))


class Kitti360(NumberedDrive):
    """One camera's view of one drive."""

    pairs = (CAMERAS,)
    usual_camera = "image_00"

    def __init__(self, folder: Path, camera: str) -> None:
        super().__init__(folder, camera)
        partner = self.paired_camera()
        self._homes = homes(self.folder, follow(self.folder / camera) / "data_rect")
        self.images = self._list_images(camera)
        self.others = joined(self.images, self._list_images(partner))
        if not self.images:
            raise DataError(
                f"{self.folder / camera / 'data_rect'}: no images: download data_2d_raw of {self.folder.name}"
            )
        sweeps = self._tree("data_3d_raw") / "velodyne_points" / "data"
        self.sweeps = joined(self.images, stems(sweeps, [".bin"]))
        self._perspective = read_key_values(self._calibration("perspective.txt"))
        K, self._T_cam_cam0 = self._projection(camera)
        width, height = need(self._perspective, f"S_rect_{camera[-2:]}", 2, self._calibration("perspective.txt"))
        self.camera = Camera(K, (int(height), int(width)))
        if self.others:
            right_m = float(self._T_cam_cam0[0, 3] - self._projection(partner)[1][0, 3])
            self.baseline_m = self.baseline(right_m, self._calibration("perspective.txt"))

    @property
    def name(self) -> str:
        """The data set and the sequence."""
        return f"kitti_360_{super().name}"

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        files = [self._calibration(name) for name in DOWNLOAD]
        return [
            *(path for path in files if path.is_file()),
            *([self._pose_file] if self._pose_file is not None else []),
        ]

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each sensor has, for the audit."""
        posed = [id_ for id_ in self.ids if int(id_) in self._pose_lines]
        return {"other": list(self.others), "sweep": list(self.sweeps), "pose": posed}

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the pose of this camera; None where the frame has no line."""
        T_world_cam0 = self._T_world_cam0(int(id_))
        return None if T_world_cam0 is None else T_world_cam0 @ invert(self._T_cam_cam0)

    def T_world_velo(self, number: int) -> Matrix | None:
        """Return the LiDAR's pose; None where the frame has no line, or the calibration is not there."""
        T_world_cam0 = self._T_world_cam0(number)
        return None if T_world_cam0 is None or self._T_cam0_velo is None else T_world_cam0 @ self._T_cam0_velo

    @property
    def T_cam_velo(self) -> Matrix | None:
        """The LiDAR's place at this camera (4, 4), metres; None without calib_cam_to_velo.txt."""
        return None if self._T_cam0_velo is None else self._T_cam_cam0 @ self._T_cam0_velo

    def time_s(self, id_: str) -> float | None:
        """Return the camera's own time stamp."""
        return self._times.get(int(id_))

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        sweeps = self._tree("data_3d_raw") / "velodyne_points" / "data"
        sweep = f"{sweeps}: no sweeps: download data_3d_raw of {self.folder.name}"
        if self.sweeps:
            wanted = self._calibration("calib_cam_to_velo.txt")
            sweep = f"{wanted}: no such file, so the sweeps cannot be placed: download calibration.zip"
        truth = "KITTI-360 has no depth maps: score against the LiDAR (`priors eval --against`)"
        reasons = {
            "other": f"{self.folder}/{self.partner}/data_rect: no image {id_}: stereo needs both cameras: download it",
            "sweep": sweep,
            "truth": truth,
            "sparse": truth,
            "sky": "KITTI-360 has no sky masks",
        }
        return reasons | self._lacking_poses

    def _list_images(self, camera: str) -> dict[str, Path]:
        images = stems(follow(self.folder / camera) / "data_rect", IMAGE_SUFFIXES)
        return {id_: path for id_, path in images.items() if id_.isdecimal()}

    def _tree(self, kind: str) -> Path:
        """Return the sequence's folder in another tree beside data_2d_raw; it need not be there."""
        places = [home.parent.parent / kind / home.name for home in self._homes]
        return next((place for place in places if place.is_dir()), places[0])

    def _calibration(self, name: str) -> Path:
        """Return a calibration file; it need not be there."""
        places = [home.parent.parent / "calibration" / name for home in self._homes]
        return next((place for place in places if place.is_file()), places[0])

    def _projection(self, camera: str) -> tuple[Matrix, Matrix]:
        path, key = self._calibration("perspective.txt"), f"P_rect_{camera[-2:]}"
        return split_projection(need(self._perspective, key, 12, path).reshape(3, 4), key, path)

    @cached_property
    def _R_rect(self) -> Matrix:
        """Rotation of camera 0's rectification, (4, 4)."""
        R_rect = np.eye(4)
        path = self._calibration("perspective.txt")
        R_rect[:3, :3] = need(self._perspective, "R_rect_00", 9, path).reshape(3, 3)
        return R_rect

    @cached_property
    def _T_cam0_velo(self) -> Matrix | None:
        """The LiDAR's place at the rectified camera 0; None without its calibration."""
        path = self._calibration("calib_cam_to_velo.txt")
        if not path.is_file():
            return None
        return self._R_rect @ invert(parse_pose(" ".join(line.text for line in read_lines(path)), f"{path}: all of it"))

    @property
    def _pose_file(self) -> Path | None:
        folder = self._tree("data_poses")
        return next((path for name in ("poses.txt", "cam0_to_world.txt") if (path := folder / name).is_file()), None)

    @cached_property
    def _pose_lines(self) -> dict[int, Line]:
        """The lines of poses by frame number, without it; empty where no camera's pose can be told."""
        path, lines = self._pose_file, {}
        if path is None or (path.name == "poses.txt" and not self._calibration("calib_cam_to_pose.txt").is_file()):
            return {}
        for line in read_lines(path):
            number, *words = line.words or [""]
            if number.replace(".0", "").isdecimal():
                lines[int(float(number))] = Line(line.number, " ".join(words[:12]))  # cam0_to_world has a fourth row
        return lines

    def _T_world_cam0(self, number: int) -> Matrix | None:
        """Return the pose of the rectified camera 0; None for a frame in which the car stood still."""
        path, line = self._pose_file, self._pose_lines.get(number)
        if path is None or line is None:
            return None
        T_world_rig = parse_pose(line.text, f"{path}: line {line.number}")
        return T_world_rig @ self._T_pose_cam0 if path.name == "poses.txt" else T_world_rig

    @cached_property
    def _T_pose_cam0(self) -> Matrix:
        path = self._calibration("calib_cam_to_pose.txt")
        T_pose_cam0 = np.eye(4)
        T_pose_cam0[:3] = need(read_key_values(path), "image_00", 12, path).reshape(3, 4)
        return T_pose_cam0 @ invert(self._R_rect)

    @cached_property
    def _lacking_poses(self) -> dict[str, str]:
        """Say why a frame has no pose: by mistake (pose), or because the data set has none (poses)."""
        if self._pose_file is None:
            wanted = self._tree("data_poses") / "poses.txt"
            return {"poses": f"{wanted}: no such file: download data_poses of {self.folder.name}"}
        if self._pose_lines:
            return {"poses": f"{self._pose_file}: no line of this frame: the car stood still in it, leave it out"}
        path = self._calibration("calib_cam_to_pose.txt")
        if self._pose_file.name == "poses.txt" and not path.is_file():
            return {"pose": f"{path}: no such file, so poses.txt tells no camera's pose: {DOWNLOAD[path.name]}"}
        return {"pose": f"{self._pose_file}: no line begins with a frame's number: download data_poses again"}

    @property
    def times_file(self) -> Path:
        """timestamps.txt of this camera, there or not."""
        return self.folder / self.camera_name / "timestamps.txt"

    @cached_property
    def _times(self) -> dict[int, float]:
        """Camera times by frame number."""
        return read_times(self.times_file) if self.times_file.is_file() else {}

    @cached_property
    def path(self) -> Trajectory:
        """The trajectory of camera 0, by frame number; lines that are no poses are left out."""
        poses = readable(self._pose_lines, self._T_world_cam0)
        return Trajectory.of_numbers(poses, self._times)
