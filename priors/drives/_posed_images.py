"""Images with poses of any cameras: what the readers of nerfstudio's and COLMAP's folders share."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from priors import codecs
from priors.drives._camera_drive import BY_FRAME, CameraDrive
from priors.drives._lens import Lens
from priors.errors import DataError
from priors.frame_ids import in_order
from priors.types import Camera, Depth, FloatMap, Image, Matrix


@dataclass(frozen=True)
class View:
    """One image."""

    path: Path
    lens: Lens
    T_world_cam: Matrix | None
    """(4, 4), OpenCV axes; None where there is none."""


class PosedImages(CameraDrive):
    """Views by frame id; images and maps are straightened when they are read."""

    usual_camera = "images"
    views: Mapping[str, View]

    def take(self, views: Mapping[str, View]) -> None:
        """Take the views in: a subclass calls it in its `__init__`; DataError where none has an image."""
        there = {id_: view for id_, view in views.items() if view.path.is_file()}
        if not there:
            first = next(iter(views.values()), None)
            named = "no images" if first is None else f"no such file: none of its {len(views)} images is there"
            raise DataError(f"{self.folder if first is None else first.path}: {named}: put them there")
        self.views = {id_: there[id_] for id_ in in_order(there)}
        self.absent = len(views) - len(there)
        self.images = {id_: view.path for id_, view in self.views.items()}
        self.camera = self.camera_of(self.ids[0])

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: also whether cameras differ."""
        alike = len({view.lens for view in self.views.values()}) == 1
        return {**super().describe(), **({} if alike else {"cameras": BY_FRAME})}

    def notes(self) -> list[str]:
        """Say which images are missing, and what was done to the others."""
        lenses = {view.lens for view in self.views.values()}
        bent = [view.lens for view in self.views.values() if view.lens.bends]
        some = f"{len(lenses)} cameras, the first: " if len(lenses) > 1 else ""
        straightened = [some + bent[0].describe()] if bent else []
        absent = [f"{self.absent} images that are listed are not there"] if self.absent else []
        return straightened + absent

    def camera_of(self, id_: str) -> Camera:
        """Return the camera of a straightened image."""
        return self.views[id_].lens.camera

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the image's pose."""
        return self.views[id_].T_world_cam

    def read_image(self, path: Path, id_: str) -> Image:
        """Read and straighten an image."""
        return self.views[id_].lens.straighten(self.sized(codecs.read_image(path), path, id_))

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read and straighten a depth map."""
        return Depth(self.shown_map(self.sized(codecs.read_float_map(path), path, id_), id_))

    def shown_map(self, values: FloatMap, id_: str) -> FloatMap:
        """Straighten a map of an image as it is stored; one of another size is left for others to refuse."""
        lens = self.views[id_].lens
        return lens.straighten_map(values) if values.shape == lens.size else values

    def sized(self, array: Any, path: Path, id_: str) -> Any:
        """Return an image or a map as it was read; DataError where it has not the calibration's size."""
        size = self.views[id_].lens.size
        if array.shape[:2] != size:
            found, wanted = (f"{width}x{height}" for height, width in (array.shape[:2], size))
            raise DataError(f"{path}: is {found}, the calibration is for {wanted}: name the images it was made for")
        return array


def ids_of(names: list[str]) -> list[str]:
    """Return a frame id for each image's name: its stem, with the folders before it where stems are alike."""
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return ["_".join(part for part in path.with_suffix("").parts if part not in (".", "..", "/")) for path in paths]


def check_pose(T: Any, where: str) -> Matrix:
    """Return a camera's pose (4, 4) or (3, 4) as (4, 4); DataError where it is none: `where` names it."""
    try:
        matrix = np.asarray(T, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise DataError(f"{where}: expected a pose of 4x4 finite numbers: write it again")
    T_world_cam = np.eye(4)
    T_world_cam[:3] = matrix[:3]
    return T_world_cam


def masked(depth_m: FloatMap, mask: Image) -> FloatMap:
    """Return a map without what a mask (black = left out) covers."""
    seen = mask if mask.ndim == 2 else mask[..., 0]
    return np.where(seen > 0, depth_m, np.float32(0))
