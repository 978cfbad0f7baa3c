"""COLMAP: a sparse model, text or binary, and its images.

    images/<name>   sparse/0/{cameras,images,points3D}.{bin,txt}      also sparse/ or the folder itself
    [depths_gt/<stem>.png   depths_mono_crop/ ...]                    the study's release

Quirks kept here (those of the tables in _colmap_model.py):
- Lenses that bend lines are straightened when an image is read (_lens.py). Fish-eye models are refused.
- The points that an image observes are its sparse depth: what completion fills. Others may be hidden from it.
- COLMAP's unit is its own: metres only where poses were given in metres, as the study gave them.
- The study "Digging into Depth Priors for Outdoor Neural Radiance Fields" released its sequences so: depths_gt is truth
  (Argoverse: depths), uint16, metres x 256; depths_mono_crop and others are priors for `priors import`.
"""

from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.drives import DriveOptions
from priors.drives._camera_drive import Files, Readers
from priors.drives._colmap_model import Ids, Shot, find_file, read_lenses, read_points, read_shots
from priors.drives._files import stems, subfolders
from priors.drives._posed_images import PosedImages, View, ids_of
from priors.errors import DataError, UsageError
from priors.frame_ids import joined
from priors.geometry import invert, project, scatter_nearest, transform
from priors.types import Depth

TABLES = ("cameras", "images")
TRUTHS = ("depths_gt", "depths")
PRIORS = "depths_"
NEAREST = 1e-6
"""Nearer points lie in the camera's plane, or behind."""


def recognises(path: Path) -> bool:
    """Tell whether the folder holds a sparse model."""
    return _model_folder(path) is not None


def open_drive(path: Path, options: DriveOptions) -> "Colmap":
    """Open the folder."""
    if options.drive not in (None, path.absolute().name):
        raise UsageError(f"{path}: is one drive, there is no {options.drive!r} in it: leave --drive out")
    if options.camera not in (None, Colmap.usual_camera):
        raise UsageError(f"{path}: all images of the model are one drive: leave --camera {options.camera} out")
    return Colmap(path, options.truth)


def _model_folder(path: Path) -> Path | None:
    """Return the folder with the tables: sparse/0, sparse, or the folder itself; None without one.

    In sparse/ one table tells that a model is meant.
    """
    inside = (path / "sparse" / "0", path / "sparse")
    found = (place for place in inside if any(find_file(place, stem) for stem in TABLES))
    return next(found, path if all(find_file(path, stem) for stem in TABLES) else None)


class Colmap(PosedImages):
    """The images of a sparse model."""

    def __init__(self, folder: Path, truth: Path | None = None) -> None:
        super().__init__(folder, self.usual_camera, truth)
        model = _model_folder(self.folder)
        if model is None:
            raise DataError(f"{folder}: no cameras and images tables (.bin or .txt) in sparse/0, sparse or here")
        self._model = model
        lenses, shots = read_lenses(self._table("cameras")), read_shots(self._table("images"))
        if not shots:
            raise DataError(f"{self._table('images')}: no images: did the reconstruction fail?")
        self._shots = dict(zip(ids_of([shot.name for shot in shots]), shots, strict=True))
        lost = next((shot for shot in shots if shot.camera not in lenses), None)
        if lost is not None:
            raise DataError(f"{self._table('cameras')}: no camera {lost.camera}, which {lost.name} names")
        folder_of_images = next((path for path in (self.folder / "images", self.folder) if path.is_dir()), self.folder)
        self.take(
            {
                id_: View(folder_of_images / shot.name, lenses[shot.camera], shot.T_world_cam)
                for id_, shot in self._shots.items()
            }
        )
        maps = next((found for place in self._truth_places() if (found := stems(place, [".png"]))), {})
        if truth is not None and not maps:
            raise DataError(f"{truth}: --truth should hold depth maps, uint16 PNG of metres x 256, found none")
        self.maps = {"truth": joined(self.images, maps)}

    def sources(self) -> list[Path]:
        """List the tables."""
        return [path for stem in (*TABLES, "points3D") if (path := find_file(self._model, stem)) is not None]

    def notes(self) -> list[str]:
        """Say how lenses were straightened, what the unit is, and which priors lie beside."""
        notes = super().notes()
        if not self.maps["truth"]:
            notes.append("COLMAP tells no unit: its model's unit is taken for metres")
        beside = [path.name for path in subfolders(self.folder) if path.name.startswith(PRIORS)]
        priors = [name for name in beside if name not in TRUTHS]
        if priors:
            notes.append(f"depth maps of others beside: {', '.join(priors)}: `priors import` takes them")
        return notes

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that have truth, and those that observe points, for the audit."""
        seeing = [id_ for id_ in self.ids if len(self._shots[id_].points)]
        return {"truth": list(self.maps["truth"]), "sparse": seeing if self._has_points else []}

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also the points that it observes."""
        readers = super().readers(id_)
        if self._has_points and len(self._shots[id_].points):
            readers["sparse"] = lambda: self._read_points(id_)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the points'."""
        return super().files(id_) | {"sparse": lambda: find_file(self._model, "points3D")}

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        sparse = f"{self._table('images')}: {self._shots[id_].name} observes no points: use mono"
        if not self._has_points:
            sparse = f"{self._model}: no points3D table: copy it beside the others, or use mono"
        return {
            "other": "a COLMAP model has no stereo pairs: use mono, or completion of its points",
            "sweep": "a COLMAP model has no LiDAR: use mono, or completion of its points",
            "truth": f"{self.folder / TRUTHS[0]}: no map {id_}.png: --truth names a folder of metres x 256",
            "sparse": sparse,
            "sky": "a COLMAP model has no sky masks",
        }

    @property
    def _has_points(self) -> bool:
        return find_file(self._model, "points3D") is not None

    def _table(self, stem: str) -> Path:
        return find_file(self._model, stem) or self._model / f"{stem}.bin"

    def _truth_places(self) -> list[Path]:
        return [self.folder / name for name in TRUTHS] if self.truth is None else [self.truth]

    def _read_points(self, id_: str) -> Depth:
        """Project the points that an image observes."""
        ids, xyz = self._points
        shot: Shot = self._shots[id_]
        places = np.searchsorted(ids, shot.points)
        known = places < len(ids)
        known[known] = ids[places[known]] == shot.points[known]
        xyz_cam = transform(invert(shot.T_world_cam), xyz[places[known]])
        uv_px, depth_m = project(self.camera_of(id_), xyz_cam)
        before = depth_m > NEAREST
        return Depth(scatter_nearest(uv_px[before], depth_m[before], self.camera_of(id_).size))

    @cached_property
    def _points(self) -> tuple[Ids, npt.NDArray[np.float64]]:
        path = find_file(self._model, "points3D")
        if path is None:
            raise DataError(f"{self._model}: no points3D table: copy it beside the others")
        return read_points(path)
