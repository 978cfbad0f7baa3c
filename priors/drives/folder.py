"""Your own images: a folder with left/, perhaps right/, and one calib.json.

    left/<id>.png   right/<id>.png   calib.json
    [depth/<id>.png   sparse/<id>.png   lidar/<id>.bin   calib/<id>.json   poses.txt]

calib.json: {"fx": 721.5, "fy": 721.5, "cx": 609.6, "cy": 172.9, "baseline_m": 0.54}, in pixels and metres; both cameras
share it; "baseline_m" is needed where there is right/; "width" and "height" are checked where they are given.
The pair must be rectified and undistorted. "rig": "kitti" says that KITTI's car took the images: stereo then corrects
the usual error of their rectification (docs/methods/stereo.md).

"T_cam_lidar": 12 numbers, row by row, take a LiDAR's points to the left camera, in metres. lidar/ needs it, and
completion fills maps in sparse/ better with it. calib/<id>.json has what differs at one frame, by the same keys.

- Files are joined by their stem, the frame id.
- depth/ is truth, sparse/ is completion's input: uint16 PNG (metres x 256), .npy, .npz or .pfm in metres, 0 = none.
- lidar/ holds sweeps: .bin (float32 x y z reflectance) or .npy ((n, 3) or more columns, x y z first), metres, in the
  LiDAR's frame at the image's time: motion within the sweep must be taken out already.
- Numbers sort and join as numbers: 9 before 10, and 7.png with 000007.png.
- poses.txt holds one T_world_cam of the left camera a line: 12 numbers, a row-major (3, 4), OpenCV axes, metres. A line
  may begin with the frame id; without ids there must be as many lines as left images, in their order.
  Lines that begin with # are comments.
"""

from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from priors.drives import BY_FRAME, CameraDrive, DriveOptions
from priors.drives._camera_drive import Files, Readers
from priors.drives._files import IMAGE_SUFFIXES, first_size, follow, image_size, stems
from priors.drives._folder_calibration import Calibration, calibration
from priors.drives._points import only_points
from priors.drives._velodyne import read_sweep_file
from priors.errors import DataError
from priors.frame_ids import joined
from priors.geometry import invert
from priors.motion import Trajectory
from priors.poses import WITH_ID, by_id, parse_pose, read_pose_lines, readable
from priors.text import Line, read_json
from priors.types import Camera, Matrix, Sweep

SWEEP_SUFFIXES = (".bin", ".npy")
MAP_SUFFIXES = (".png", ".npy", ".npz", ".pfm")
MAPS = {"truth": "depth", "sparse": "sparse"}
WANTED = "write fx, fy, cx, cy and baseline_m into it (docs/datasets.md)"


def recognises(path: Path) -> bool:
    """Tell whether the folder has left/, and calib.json or right/ beside."""
    return (path / "left").exists() and any((path / name).exists() for name in ("calib.json", "right"))


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
        self._sweeps = joined(self.images, stems(follow(self.folder / "lidar"), SWEEP_SUFFIXES))
        self._calibrations = joined(self.images, stems(follow(self.folder / "calib"), [".json"]))
        self._values = read_json(self.folder / "calib.json", WANTED)
        self._shared, self._own = self._read_shared(), lru_cache(maxsize=None)(self._read_own)
        self.camera, self.baseline_m, self.rig = (
            self.camera_of(self.ids[0]),
            self.baseline_of(self.ids[0]),
            self._shared.rig,
        )

    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""
        poses = self.folder / "poses.txt"
        own = [self._calibrations[id_] for id_ in self.ids if id_ in self._calibrations]
        return [self.folder / "calib.json", *own, *([poses] if poses.is_file() else [])]

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: also that cameras differ by frame, where they do."""
        return {**super().describe(), **({"cameras": BY_FRAME} if self._calibrations else {})}

    def camera_of(self, id_: str) -> Camera:
        """Return the frame's camera."""
        return self._calibration(id_).camera

    def baseline_of(self, id_: str) -> float | None:
        """Return the baseline of the frame's pair, metres."""
        return self._calibration(id_).baseline_m

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Return where the LiDAR is at a frame; None where no calibration says it."""
        T_left_lidar = self._calibration(id_).T_left_lidar
        return None if T_left_lidar is None else invert(self._T_left_cam(id_)) @ T_left_lidar

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also sweeps, where the LiDAR's place is known."""
        readers = super().readers(id_)
        if self._sweeps and self._calibration(id_).T_left_lidar is not None:
            readers["sweep"] = lambda offset=0: self._sweep(id_, offset)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also sweeps."""
        return super().files(id_) | {"sweep": lambda offset=0: self._sweeps.get(self._beside(id_, offset) or "")}

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, for the audit."""
        try:
            posed = list(self._pose_lines)
        except DataError:  # told of each frame
            posed = []
        kinds = {"other": list(self.others), "depth": list(self.maps["truth"]), "pose": posed}
        return kinds | ({"sweep": list(self._sweeps)} if self._sweeps else {})

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        maps = {
            what: f"{self.folder / name}: no map {id_} (.png, .npy, .npz or .pfm): put it there"
            for what, name in MAPS.items()
        }
        sweep = "this folder has no LiDAR: use stereo, completion of maps in sparse/, or put sweeps in lidar/"
        if self._sweeps:
            sweep = f"{self.folder / 'calib.json'}: no T_cam_lidar, so the sweeps in lidar/ cannot be placed: add it"
        return {
            **maps,
            "poses": f"{self.folder / 'poses.txt'}: no pose of this frame: write T_world_cam, 12 numbers a line",
            "other": f"{self.folder}/{self.partner}: no image {id_}: stereo needs both cameras: put it there",
            "sweep": sweep,
        }

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the pose that poses.txt tells."""
        if id_ not in self._pose_lines:
            return None
        line = self._pose_lines[id_]
        T_world_left = parse_pose(line.text, f"{self.folder / 'poses.txt'}: line {line.number}")
        return T_world_left @ self._T_left_cam(id_)

    def _T_left_cam(self, id_: str) -> Matrix:
        """Return where this camera is beside the left one."""
        T_left_cam, baseline_m = np.eye(4), self.baseline_of(id_)
        if self.side == "right" and baseline_m is not None:
            T_left_cam[0, 3] = baseline_m
        return T_left_cam

    def _beside(self, id_: str, offset: int) -> str | None:
        """Return the id of the frame `offset` images from a frame; None beyond the drive's ends."""
        position = self._positions[id_] + offset
        return self.ids[position] if 0 <= position < len(self.ids) else None

    @cached_property
    def _positions(self) -> dict[str, int]:
        return {id_: position for position, id_ in enumerate(self.ids)}

    def _sweep(self, id_: str, offset: int) -> Sweep | None:
        """Read the sweep `offset` images from a frame; None where that one has none."""
        beside = self._beside(id_, offset)
        if beside is None or beside not in self._sweeps:
            return None
        return self._path.without_far_side(self._read_sweep(beside), id_, beside)

    def _read_sweep(self, id_: str) -> Sweep:
        T_world_cam, T_cam_lidar = self.T_world_cam(id_), self.T_cam_lidar(id_)
        placed = None if T_world_cam is None or T_cam_lidar is None else T_world_cam @ T_cam_lidar
        return Sweep(read_points(self._sweeps[id_]), placed)

    @cached_property
    def _path(self) -> Trajectory:
        """The cameras' trajectory; lines that are no poses are left out."""
        poses = readable(range(len(self.ids)), lambda position: self.T_world_cam(self.ids[position]))
        path = Trajectory.of_numbers(poses, {})
        return replace(path, names=[self.ids[position] for position in sorted(poses)])

    def _calibration(self, id_: str) -> Calibration:
        """Return what calib.json and the frame's own file say."""
        return self._own(id_) if id_ in self._calibrations else self._shared

    def _read_shared(self) -> Calibration:
        path = self.folder / "calib.json"
        return calibration(self._values, path, first_size(self.images.values()), bool(self.others))

    def _read_own(self, id_: str) -> Calibration:
        path = self._calibrations[id_]
        values = self._values | read_json(path)
        return calibration(values, path, image_size(self.images[id_]), id_ in self.others)

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


def read_points(path: Path) -> npt.NDArray[np.float32]:
    """Read a sweep's points (n, 3), metres, of a .bin or .npy; DataError where it is none."""
    if path.suffix == ".bin":
        return read_sweep_file(path)
    try:
        table = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read as a NumPy array ({error}): write it again by np.save") from error
    if table.ndim != 2 or table.shape[1] < 3 or not np.issubdtype(table.dtype, np.floating):
        raise DataError(f"{path}: expected floats (n, 3 or more), x y z in metres, found {table.dtype} {table.shape}")
    xyz_m = np.ascontiguousarray(table[:, :3], dtype=np.float32)
    return xyz_m[only_points(xyz_m, path, "x y z in metres")]
