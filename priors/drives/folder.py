"""Your own images: a folder with left/, perhaps right/, and one calib.json.

    left/<id>.png   right/<id>.png   calib.json   [depth/<id>.png   sparse/<id>.png   poses.txt]

calib.json: {"fx": 721.5, "fy": 721.5, "cx": 609.6, "cy": 172.9, "baseline_m": 0.54}, in pixels and metres; both cameras
share it; "baseline_m" is needed where there is right/; "width" and "height" are checked where they are given.
The pair must be rectified and undistorted. "rig": "kitti" says that KITTI's car took it: stereo then corrects the
usual error of their rectification (priors/pairs/offset.py).

- Files are joined by their stem, the frame id.
- depth/ is truth, sparse/ is completion's input: uint16 PNG (metres x 256), .npy, .npz or .pfm in metres, 0 = none.
- poses.txt holds one T_world_cam of the left camera a line: 12 numbers, a row-major (3, 4), OpenCV axes, metres. A line
  may begin with the frame id; without ids there must be as many lines as left images, in their sorted order.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from priors import codecs
from priors.drives import DriveOptions
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_baseline,
    check_size,
    digest,
    first_size,
    follow,
    parse_pose,
    read_json,
    read_sized,
    read_text,
    stems,
)
from priors.drives._rigs import RIGS
from priors.errors import DataError
from priors.types import Camera, Depth, Frame, Matrix, Rig

PARTNER = {"left": "right", "right": "left"}
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


class Folder:
    """One camera's view of a folder of images."""

    def __init__(self, folder: Path, camera: str = "left") -> None:
        self.folder, self.camera_name = folder.absolute(), camera
        if camera not in PARTNER:
            raise DataError(f"{folder}: no camera {camera!r}: choose left or right")
        self._images = stems(follow(self.folder / camera), IMAGE_SUFFIXES)
        if not self._images:
            raise DataError(f"{folder / camera}: no PNG or JPEG images: put the {camera} images there")
        self._others = stems(follow(self.folder / PARTNER[camera]), IMAGE_SUFFIXES)
        self._maps = {what: stems(follow(self.folder / name), MAP_SUFFIXES) for what, name in MAPS.items()}
        self.ids: Sequence[str] = list(self._images)
        self._camera, self.baseline_m, self._rig = self._read_calibration()

    @property
    def name(self) -> str:
        """The folder's name, and the camera's where it is not left."""
        return self.folder.name if self.camera_name == "left" else f"{self.folder.name}-{self.camera_name}"

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records and `reopen` needs."""
        return {"dataset": "folder", "path": str(self.folder), "camera": self.camera_name, "truth": None}

    def fingerprint(self) -> str:
        """Digest calibration, poses and the first image."""
        poses = [path for path in [self.folder / "poses.txt"] if path.is_file()]
        return digest([self.folder / "calib.json", *poses, next(iter(self._images.values()))])

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, for the audit."""
        return {"other": list(self._others), "depth": list(self._maps["truth"]), "pose": list(self._pose_lines)}

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        id_ = self.ids[index]
        sources: dict[str, Any] = {"image": partial(read_sized, self._images[id_], self._camera)}
        if id_ in self._others:
            sources["other"] = partial(read_sized, self._others[id_], self._camera)
        for what, maps in self._maps.items():
            if id_ in maps:
                sources[what] = partial(self._read_map, maps[id_])
        missing = {
            what: f"{self.folder / name}: no map {id_} (.png, .npy, .npz or .pfm)" for what, name in MAPS.items()
        }
        missing["other"] = f"{self.folder / PARTNER[self.camera_name]}: no image {id_}: stereo needs both cameras"
        missing["sweep"] = "a folder of images has no LiDAR: use stereo, or completion of maps in sparse/"
        return Frame(
            id=id_,
            camera=self._camera,
            readers=sources,
            missing=missing,
            T_world_cam=self._pose(id_),
            baseline_m=self.baseline_m,
            rig=self._rig,
            side="left" if self.camera_name == "left" else "right",
        )

    def _read_calibration(self) -> tuple[Camera, float | None, Rig | None]:
        path = self.folder / "calib.json"
        data = read_json(path)
        fx, fy, cx, cy = (_number(data, key, path) for key in ("fx", "fy", "cx", "cy"))
        if fx <= 0 or fy <= 0:
            raise DataError(f"{path}: fx and fy should be > 0 pixels, found {fx:g} and {fy:g}")
        baseline_m = None
        if self._others or "baseline_m" in data:
            baseline_m = check_baseline(_number(data, "baseline_m", path), "baseline_m", path)
        if "width" in data or "height" in data:
            size = (int(_number(data, "height", path)), int(_number(data, "width", path)))
        else:
            size = first_size(self._images.values())
        if not (0 < cx < size[1] - 1 and 0 < cy < size[0] - 1):
            found = f"the centre ({cx:g}, {cy:g}) lies outside the {size[1]}x{size[0]} images"
            raise DataError(f"{path}: {found}: was one of them resized?")
        camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size)
        return camera, baseline_m, _known_rig(data.get("rig"), path)

    @cached_property
    def _pose_lines(self) -> dict[str, tuple[int, str]]:
        """Line number and 12 numbers by frame id; empty without poses.txt."""
        path = self.folder / "poses.txt"
        if not path.is_file():
            return {}
        lines = [(n, line) for n, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
        if lines and all(len(line.split()) == 13 for _, line in lines):
            return {line.split()[0]: (n, line.split(maxsplit=1)[1]) for n, line in lines}
        lefts = list(stems(follow(self.folder / "left"), IMAGE_SUFFIXES))
        if len(lines) != len(lefts):
            found = f"{len(lines)} poses for {len(lefts)} left images"
            raise DataError(f"{path}: {found}: begin each line with its frame id, or give one line an image")
        return dict(zip(lefts, lines, strict=True))

    def _pose(self, id_: str) -> Matrix | None:
        if id_ not in self._pose_lines:
            return None
        number, line = self._pose_lines[id_]
        T_world_left = parse_pose(line, f"{self.folder / 'poses.txt'}: line {number}")
        T_left_cam = np.eye(4)
        if self.camera_name == "right" and self.baseline_m is not None:
            T_left_cam[0, 3] = self.baseline_m
        return T_world_left @ T_left_cam

    def _read_map(self, path: Path) -> Depth:
        return Depth(check_size(codecs.read_float_map(path), path, self._camera))


def _known_rig(rig: Any, path: Path) -> Rig | None:
    """Return the calibration's rig; raises DataError where it is not a known one."""
    if rig is None:
        return None
    for name, known in RIGS.items():
        if rig == name:
            return known
    raise DataError(f"{path}: rig {rig!r} is not known: leave it out, or choose one of {', '.join(RIGS)}")


def _number(data: dict[str, Any], key: str, path: Path) -> float:
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        found = f"found {value!r}" if key in data else "it is missing"
        raise DataError(f"{path}: {key} should be a number: {found}: see docs/datasets.md")
    return float(value)
