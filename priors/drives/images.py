"""Plain images: a folder of pictures of one camera, and nothing else.

    <id>.jpg (or .png, .webp, .bmp, .tif), as many as there are

Quirks kept here (those of the files' headers in _exif.py):
- The focal length is what --fx says, in pixels of the pictures as they are shown, else what EXIF tells of each picture.
  The principal point is the middle. A lens that bends straight lines is not straightened.
- EXIF may say that the camera was held sideways: pictures are turned upright, as every viewer shows them.
- Any folder of pictures looks like this. It is a drive only where DATA names it and no other data set knows it.
"""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from priors import codecs
from priors.drives import BY_FRAME, CameraDrive, DriveOptions
from priors.drives._exif import Shot, read_shot
from priors.drives._files import check_size, stems
from priors.errors import DataError, UsageError
from priors.types import Camera, Image

LAST, TAKES_FX = True, True
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")


def recognises(path: Path) -> bool:
    """Tell whether the folder itself holds pictures."""
    return bool(stems(path, SUFFIXES))


def is_drive(folder: Path) -> bool:
    """Tell that no folder is one to be found: pictures lie everywhere."""
    return False


def open_drive(path: Path, options: DriveOptions) -> "Images":
    """Open the folder."""
    if options.drive not in (None, path.absolute().name):
        raise UsageError(f"{path}: is one drive, there is no {options.drive!r} in it: leave --drive out")
    if options.camera not in (None, Images.usual_camera):
        raise UsageError(f"{path}: a folder of images has one camera: leave --camera {options.camera} out")
    if options.truth is not None:
        raise UsageError(f"{path}: images alone have no truth: put them into left/ and depth/ (docs/datasets.md)")
    return Images(path, options.fx)


class Images(CameraDrive):
    """The pictures of a folder."""

    usual_camera = "image"

    def __init__(self, folder: Path, fx: float | None = None) -> None:
        super().__init__(folder, self.usual_camera)
        self.fx = fx
        self.images = stems(self.folder, SUFFIXES)
        if not self.images:
            raise DataError(f"{folder}: no images ({', '.join(SUFFIXES)}): name the folder that holds them")
        self.camera = self.camera_of(next(id_ for id_, shot in self._shots.items() if shot is not None))

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: also --fx, and whether pictures differ in size or focal length."""
        cameras = {} if self._is_alike else {"cameras": BY_FRAME}
        return {**super().describe(), **cameras, **({} if self.fx is None else {"fx": self.fx})}

    def sources(self) -> list[Path]:
        """List no file: the focal length stands in the pictures, or was typed."""
        return []

    def notes(self) -> list[str]:
        """Say where the focal length comes from."""
        if self.fx is not None:
            return []
        return [f"the focal length is EXIF's, {self.camera.fx:.0f} px of the first image: --fx says it better"]

    def camera_of(self, id_: str) -> Camera:
        """Return a picture's camera.

        Raises:
            DataError: the picture is damaged, or nobody says its focal length.
        """
        shot = self._shots[id_] or read_shot(self.images[id_])  # raises what is wrong with it
        fx = self.fx or shot.focal_px
        if fx is None:
            raise DataError(f"{self.images[id_]}: its EXIF tells no focal length: give it in pixels, --fx 1200 say")
        height, width = shot.size
        return Camera(np.array([[fx, 0, (width - 1) / 2], [0, fx, (height - 1) / 2], [0, 0, 1]]), shot.size)

    def read_image(self, path: Path, id_: str) -> Image:
        """Read a picture and turn it upright."""
        shot = self._shots[id_] or read_shot(path)
        return np.asarray(check_size(shot.upright(codecs.read_image(path)), path, self.camera_of(id_)))

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        alone = "images alone: use mono"
        return {
            "poses": "images alone have no poses: give some by COLMAP's model or transforms.json (docs/datasets.md)",
            "other": f"{alone}, or put a pair into left/ and right/ (docs/datasets.md)",
            "sweep": alone,
            "truth": "images alone have no truth: put it into depth/ beside left/ (docs/datasets.md)",
            "sparse": alone,
            "sky": "images alone have no sky masks",
        }

    @cached_property
    def _shots(self) -> dict[str, Shot | None]:
        """What each file's header says; None where it is damaged, which is told when it is read."""
        shots: dict[str, Shot | None] = {}
        reason = DataError(f"{self.folder}: no images")
        for id_, path in self.images.items():
            try:
                shots[id_] = read_shot(path)
            except DataError as error:
                shots[id_], reason = None, error
        known = [shot for shot in shots.values() if shot is not None]
        if not known:
            raise reason
        if self.fx is not None and len({tuple(sorted(shot.size)) for shot in known}) > 1:
            sizes = " and ".join(f"{w}x{h}" for h, w in sorted({shot.size for shot in known})[:2])
            raise UsageError(f"--fx {self.fx:g}: the images have several sizes ({sizes}): make a folder of each size")
        return shots

    @property
    def _is_alike(self) -> bool:
        """Tell whether one camera took all pictures, held one way."""
        known = [shot for shot in self._shots.values() if shot is not None]
        return len({(shot.size, None if self.fx else shot.focal_px) for shot in known}) == 1
