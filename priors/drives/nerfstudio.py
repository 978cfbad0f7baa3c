"""nerfstudio: a transforms.json beside the images that it names, as ns-process-data and ns-export write it.

    transforms.json   images/frame_00001.png   [depth/frame_00001.png   masks/frame_00001.png]

Quirks kept here (nerfstudio's docs, "Data conventions", and its nerfstudio_dataparser.py):
- transform_matrix is T_world_cam with OpenGL axes (x right, y up, z backward): y and z are turned to OpenCV's.
- The centre of the top-left pixel is (0.5, 0.5): half a pixel is taken from cx and cy.
- Intrinsics stand at the top, or in each frame, which wins; instant-ngp's camera_angle_x, radians, stands for fl_x.
- k1 k2 p1 p2 k3 bend lines as OpenCV's do: images are straightened when they are read (_lens.py).
- depth_file_path is the camera-z depth. The file does not tell its unit: 16-bit PNG are millimetres, as nerfstudio's
  default has it, and .npy are metres, unless "depth_unit_scale_factor" at the top says how many metres one is.
- What a mask paints black is to be left out: such depth has no value. Colours are not masked.
- The world is the one of the file. It is metric where what wrote it was: COLMAP's is not.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from priors import codecs
from priors.drives import DriveOptions
from priors.drives._camera_drive import Files
from priors.drives._files import image_size
from priors.drives._lens import Lens
from priors.drives._posed_images import PosedImages, View, check_pose, ids_of, masked
from priors.errors import DataError, UsageError
from priors.text import read_json
from priors.types import Depth

NAME = "transforms.json"
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
UNIT = "depth_unit_scale_factor"
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
WRITE = "write transforms.json again"
Entry = Mapping[str, Any]


def recognises(path: Path) -> bool:
    """Tell whether the folder has a transforms.json."""
    return (path / NAME).is_file()


def open_drive(path: Path, options: DriveOptions) -> "Nerfstudio":
    """Open the folder."""
    if options.drive not in (None, path.absolute().name):
        raise UsageError(f"{path}: is one drive, there is no {options.drive!r} in it: leave --drive out")
    if options.camera not in (None, Nerfstudio.usual_camera):
        raise UsageError(f"{path}: all images of {NAME} are one drive: leave --camera {options.camera} out")
    if options.truth is not None:
        raise UsageError(f"{path}: {NAME} names the depth: leave --truth out")
    return Nerfstudio(path)


class Nerfstudio(PosedImages):
    """The images of a transforms.json."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, self.usual_camera)
        self._file = self.folder / NAME
        self._top = read_json(self._file)
        entries = self._entries()
        ids = ids_of([str(entry["file_path"]) for entry in entries])
        self._by_id = dict(zip(ids, entries, strict=True))
        self.take({id_: self._view(id_, entry) for id_, entry in self._by_id.items()})
        depths = {id_: self._place(entry["depth_file_path"]) for id_, entry in self._by_id.items() if _has_depth(entry)}
        self._lost = {id_: path for id_, path in depths.items() if not path.is_file()}
        self.maps = {"truth": {i: path for i, path in depths.items() if i in self.images and i not in self._lost}}
        self._factor = self._read_unit()

    def sources(self) -> list[Path]:
        """List the file of calibration and poses."""
        return [self._file]

    def notes(self) -> list[str]:
        """Say how lenses were straightened, and in which unit depth was read."""
        notes = super().notes()
        if self.maps["truth"]:
            told = f"{UNIT} {self._factor:g}" if self._factor is not None else "PNG in millimetres, .npy in metres"
            notes.append(f"depth files were read as {told}: {UNIT} at the top of {NAME} says otherwise")
        if any(entry.get("mask_path") for entry in self._by_id.values()):
            notes.append("masks: depth that they paint black is left out; colours are not masked")
        return notes

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        truth = f"{self._file}: frame {id_} names no depth_file_path: add it, or `priors import` depth maps"
        if id_ in self._lost:
            truth = f"{self._lost[id_]}: no such file, which {NAME} names: copy it there, or take its name out"
        return {
            "other": f"{NAME} has no stereo pairs: use mono",
            "sweep": f"{NAME} has no LiDAR",
            "truth": truth,
            "sparse": f"{NAME} has no sparse depth",
            "sky": f"{NAME} has no sky masks",
        }

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the mask, which is read with the depth."""
        return super().files(id_) | {"truth.mask": lambda: self._mask(id_)}

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read a depth map in its unit, without what the mask covers, and straighten it."""
        factor = self._factor
        if factor is None:
            factor = 1e-3 if path.suffix.lower() == ".png" else 1.0
        depth_m = (self.sized(codecs.read_numbers(path), path, id_) * factor).astype(np.float32)
        mask = self._mask(id_)
        if mask is not None and not mask.is_file():
            raise DataError(f"{mask}: no such file, which {NAME} names: copy it there, or take its name out")
        if mask is not None:
            depth_m = masked(depth_m, self.sized(codecs.read_image(mask), mask, id_))
        return Depth(self.shown_map(depth_m, id_))

    def _entries(self) -> list[Entry]:
        """Return the frames that the file lists; DataError where it lists none, or something else."""
        frames = self._top.get("frames")
        if not isinstance(frames, list) or not frames:
            raise DataError(f"{self._file}: no list of frames: {WRITE}")
        for number, entry in enumerate(frames):
            if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
                raise DataError(f"{self._file}: frame {number} has no file_path: {WRITE}")
        return frames

    def _view(self, id_: str, entry: Entry) -> View:
        path = self._place(entry["file_path"])
        T_world_cam = None
        if "transform_matrix" in entry:
            where = f"{self._file}: transform_matrix of {entry['file_path']}"
            T_world_cam = check_pose(entry["transform_matrix"], where) @ OPENCV_FROM_OPENGL
        return View(path, self._lens({**self._top, **entry}, path), T_world_cam)

    def _place(self, name: str) -> Path:
        """Return where a file that is named is; names without a suffix are PNG or JPEG, as in synthetic scenes."""
        path = self.folder / name.replace("\\", "/")
        if path.suffix or path.is_file():
            return path
        beside = (path.with_name(path.name + suffix) for suffix in (".png", ".jpg", ".jpeg"))
        return next((place for place in beside if place.is_file()), path.with_name(path.name + ".png"))

    def _mask(self, id_: str) -> Path | None:
        name = self._by_id[id_].get("mask_path")
        return self._place(name) if isinstance(name, str) and name else None

    def _lens(self, entry: Entry, path: Path) -> Lens:
        """Return the lens that a frame's intrinsics, or the top's, describe."""
        model = entry.get("camera_model", "OPENCV")
        if model not in MODELS:
            raise DataError(
                f"{self._file}: camera_model {model} is not read: undistort the images to PINHOLE first "
                "(`colmap image_undistorter`, say)"
            )
        if self._number(entry, "k4", 0.0):
            raise DataError(f"{self._file}: k4 {entry['k4']} is no term of OpenCV's: undistort the images first")
        size = self._size(entry, path)
        fx = self._focal(entry, "x", size[1])
        fy = self._focal(entry, "y", size[0]) if "fl_y" in entry or "camera_angle_y" in entry else fx
        centre = self._number(entry, "cx", size[1] / 2) - 0.5, self._number(entry, "cy", size[0] / 2) - 0.5
        return Lens((fx, fy), centre, size, tuple(self._number(entry, name, 0.0) for name in DISTORTION))

    def _size(self, entry: Entry, path: Path) -> tuple[int, int]:
        if "w" in entry and "h" in entry:
            return int(self._number(entry, "h")), int(self._number(entry, "w"))
        return image_size(path) if path.is_file() else (1, 1)  # it is left out, and told

    def _focal(self, entry: Entry, axis: str, side: int) -> float:
        if f"fl_{axis}" in entry:
            focal = self._number(entry, f"fl_{axis}")
        else:
            focal = 0.5 * side / float(np.tan(0.5 * self._number(entry, f"camera_angle_{axis}")))
        if not focal > 0:
            raise DataError(f"{self._file}: fl_{axis} should be > 0 pixels, found {focal:g}: {WRITE}")
        return focal

    def _number(self, entry: Entry, key: str, default: float | None = None) -> float:
        value = entry.get(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            key = "fl_x" if key == "camera_angle_x" else key
            found = f"found {entry[key]!r:.40}" if key in entry else "it is missing"
            raise DataError(f"{self._file}: {key} should be a number: {found}: {WRITE}")
        return float(value)

    def _read_unit(self) -> float | None:
        """Return how many metres a depth file's 1 is, where transforms.json says it."""
        if UNIT not in self._top:
            return None
        factor = self._number(self._top, UNIT)
        if not factor > 0:
            raise DataError(f"{self._file}: {UNIT} should be more than 0 metres, found {factor:g}")
        return factor


def _has_depth(entry: Entry) -> bool:
    return isinstance(entry.get("depth_file_path"), str) and bool(entry["depth_file_path"])
