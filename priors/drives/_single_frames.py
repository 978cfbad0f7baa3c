"""Drives of frames that have nothing to do with each other: KITTI's benchmarks of single frames."""

import re
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property, lru_cache
from itertools import islice
from os import scandir
from pathlib import Path
from typing import Any

from priors.drives._camera_drive import BY_FRAME, CameraDrive, Files, Readers
from priors.drives._files import image_size
from priors.drives._velodyne import read_sweep_file
from priors.errors import DataError
from priors.types import Camera, Matrix, Sweep

LOOKED_AT = 200
"""Files of a folder that are looked at to recognise it."""


class SingleFrames(CameraDrive):
    """One camera's view of frames that each have a camera and an image size of their own: no poses, no times."""

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: cameras differ by frame."""
        return {**super().describe(), "cameras": BY_FRAME}

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a frame has no pose: there are none."""
        return {"poses": "this benchmark's frames have nothing to do with each other: they have no poses"}

    def first_readable(self) -> tuple[Camera, float | None]:
        """Return camera and baseline of the first frame that has them: one damaged file must not close a drive.

        Raises:
            DataError: no frame has a camera.
        """
        reasons = []
        for id_ in self.ids:
            try:
                return self.camera_of(id_), self.baseline_of(id_)
            except DataError as error:
                reasons.append(error)
        raise reasons[0]

    @cached_property
    def size_of(self) -> Any:
        """Returns (height, width) of an image file by its header, once."""
        return lru_cache(maxsize=None)(image_size)


class SinglePairs(SingleFrames):
    """Pairs, each with a calibration file of its own, and perhaps with a sweep.

    A subclass sets `sweeps` in its `__init__`.
    """

    sweeps: Mapping[str, Path]
    """Frame id -> sweep."""

    @abstractmethod
    def projection(self, id_: str, camera: str) -> tuple[Matrix, Matrix]:
        """Return K (3, 3) and T_cam_cam0 (4, 4) of a camera at a frame, metres."""

    @abstractmethod
    def calibration_file(self, id_: str) -> Path:
        """Return the frame's calibration file; DataError where there is none."""

    def can_place(self, id_: str) -> bool:
        """Tell whether there is a file that says where a frame's sweep was taken."""
        return True

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, for the audit."""
        return {**super().scans(), "sweep": list(self.sweeps)}

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also its sweep; there is none of its neighbours."""
        readers = super().readers(id_)
        if id_ in self.sweeps and self.can_place(id_):
            readers["sweep"] = lambda offset=0: self._read_sweep(id_) if offset == 0 else None
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the sweep."""
        files: Files = {"sweep": lambda offset=0: self.sweeps.get(id_) if offset == 0 else None}
        return super().files(id_) | files

    def camera_of(self, id_: str) -> Camera:
        """Return the frame's own camera."""
        return Camera(self.projection(id_, self.camera_name)[0], self.size_of(self.images[id_]))

    def baseline_of(self, id_: str) -> float | None:
        """Return the baseline of the frame's own pair, metres."""
        if id_ not in self.others or self.partner is None:
            return None
        places = [self.projection(id_, name)[1][0, 3] for name in (self.camera_name, self.partner)]
        return self.baseline(float(places[0] - places[1]), self.calibration_file(id_))

    def _read_sweep(self, id_: str) -> Sweep:
        """Read a frame's sweep; there are no poses to place it in a world."""
        return Sweep(read_sweep_file(self.sweeps[id_]), None)


def has_file(folder: Path, name: re.Pattern[str]) -> bool:
    """Tell whether one of a folder's first files has such a name; False where there is no folder."""
    try:
        with scandir(folder) as entries:
            return any(name.fullmatch(entry.name) for entry in islice(entries, LOOKED_AT))
    except OSError:
        return False
