"""Your own images: a folder with left/, perhaps right/, and one calib.json.

    left/<id>.png   right/<id>.png   calib.json   [depth/<id>.png   sparse/<id>.png   poses.txt]

calib.json: {"fx": 721.5, "fy": 721.5, "cx": 609.6, "cy": 172.9, "baseline_m": 0.54}, in pixels and metres; both cameras
share it; "baseline_m" is needed where there is right/; "width" and "height" are checked where they are given.
The pair must be rectified and undistorted. "rig": "kitti" says that KITTI's car took the images: stereo then corrects
the usual error of their rectification (docs/methods/stereo.md).

- Files are joined by their stem, the frame id.
- depth/ is truth, sparse/ is completion's input: uint16 PNG (metres x 256), .npy, .npz or .pfm in metres, 0 = none.
- Numbers sort and join as numbers: 9 before 10, and 7.png with 000007.png.
- poses.txt holds one T_world_cam of the left camera a line: 12 numbers, a row-major (3, 4), OpenCV axes, metres. A line
  may begin with the frame id; without ids there must be as many lines as left images, in their order.
  Lines that begin with # are comments.
"""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import CameraDrive, DriveOptions
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_baseline,
    first_size,
    follow,
    stems,
)
from priors.drives._rigs import RIGS
from priors.errors import DataError
from priors.frame_ids import joined
from priors.poses import WITH_ID, by_id, parse_pose, read_pose_lines
from priors.text import Line, read_json
from priors.types import Camera, Matrix, Rig

MAP_SUFFIXES = (".png", ".npy", ".npz", ".pfm")
MAPS = {"truth": "depth", "sparse": "sparse"}


def recognises(path: Path) -> bool:
    """Tell whether the folder has left/ and calib.json."""
    return (path / "calib.json").is_file() and (path / "left").exists()


def open_drive(path: Path, options: DriveOptions) -> "Folder":
    """Open the folder; options.camera is left (default) or right."""
    if options.drive not in (None, path.absolute().name):
        raise DataError(f"{path}: is one drive, there is no {options.drive!r} in it: leave --drive out")
    if options.truth is not None:
        raise DataError(f"{path}: truth lies in depth/ here: leave --truth out")
    return Folder(path, options.camera or "left")


class Folder(CameraDrive):
    """One camera's view of a folder of images."""

    pairs = (("left", "right"),)
    usual_camera = "left"

    def __init__(self, folder: Path, camera: str = "left") -> None:
        super().__init__(folder.absolute(), camera)
        partner = self.paired_camera()
        self.images = stems(follow(self.folder / camera), IMAGE_SUFFIXES)
        if not self.images:
            raise DataError(f"{folder / camera}: no PNG or JPEG images: put the {camera} images there")
        self.others = joined(self.images, stems(follow(self.folder / partner), IMAGE_SUFFIXES))
        maps = {what: stems(follow(self.folder / name), MAP_SUFFIXES) for what, name in MAPS.items()}
        self.maps = {what: joined(self.images, paths) for what, paths in maps.items()}
        self.camera, self.baseline_m, self.rig = self._read_calibration()

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        poses = self.folder / "poses.txt"
        return [self.folder / "calib.json", *([poses] if poses.is_file() else [])]

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, for the audit."""
        try:
            posed = list(self._pose_lines)
        except DataError:  # told of each frame
            posed = []
        return {"other": list(self.others), "depth": list(self.maps["truth"]), "pose": posed}

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        maps = {what: f"{self.folder / name}: no map {id_} (.png, .npy, .npz or .pfm)" for what, name in MAPS.items()}
        return {
            **maps,
            "other": f"{self.folder}/{self.partner}: no image {id_}: stereo needs both cameras",
            "sweep": "a folder of images has no LiDAR: use stereo, or completion of maps in sparse/",
        }

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the pose that poses.txt tells."""
        if id_ not in self._pose_lines:
            return None
        line = self._pose_lines[id_]
        T_world_left = parse_pose(line.text, f"{self.folder / 'poses.txt'}: line {line.number}")
        T_left_cam = np.eye(4)
        if self.side == "right" and self.baseline_m is not None:
            T_left_cam[0, 3] = self.baseline_m
        return T_world_left @ T_left_cam

    def _read_calibration(self) -> tuple[Camera, float | None, Rig | None]:
        path = self.folder / "calib.json"
        data = read_json(path)
        fx, fy, cx, cy = (_number(data, key, path) for key in ("fx", "fy", "cx", "cy"))
        if fx <= 0 or fy <= 0:
            raise DataError(f"{path}: fx and fy should be > 0 pixels, found {fx:g} and {fy:g}")
        baseline_m = None
        if self.others or "baseline_m" in data:
            baseline_m = check_baseline(_number(data, "baseline_m", path), "baseline_m", path)
        if "width" in data or "height" in data:
            size = (int(_number(data, "height", path)), int(_number(data, "width", path)))
        else:
            size = first_size(self.images.values())
        if not (0 < cx < size[1] - 1 and 0 < cy < size[0] - 1):
            outside = f"the centre ({cx:g}, {cy:g}) lies outside the {size[1]}x{size[0]} images"
            raise DataError(f"{path}: {outside}: was one of them resized?")
        camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size)
        return camera, baseline_m, _rig(data.get("rig"), path)

    @cached_property
    def _pose_lines(self) -> dict[str, Line]:
        """A line of 12 numbers by frame id; empty without poses.txt."""
        path = self.folder / "poses.txt"
        if not path.is_file():
            return {}
        lines = [line for line in read_pose_lines(path) if line.text]
        named = by_id(lines, self.images, path)
        if named is not None:
            return named
        lefts = list(stems(follow(self.folder / "left"), IMAGE_SUFFIXES))
        if len(lines) != len(lefts):
            counts = f"{len(lines)} poses for {len(lefts)} left images"
            bare = sum(len(line.words) != WITH_ID for line in lines)
            wanted = "begin each line with its frame id, or give one line an image"
            if bare < len(lines):
                wanted = f"{bare} lines lack the frame id that the others begin with"
            raise DataError(f"{path}: {counts}: {wanted}")
        return joined(self.images, dict(zip(lefts, lines, strict=True)))


def _rig(name: Any, path: Path) -> Rig | None:
    """Return the rig that a calibration names; DataError where there is none of that name."""
    if name is None:
        return None
    if not isinstance(name, str) or name not in RIGS:
        raise DataError(f"{path}: rig {name!r} is not known: leave it out, or choose one of {', '.join(RIGS)}")
    return RIGS[name]


def _number(data: dict[str, Any], key: str, path: Path) -> float:
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        instead = f"found {value!r}" if key in data else "it is missing"
        raise DataError(f"{path}: {key} should be a number: {instead}: see docs/datasets.md")
    return float(value)
