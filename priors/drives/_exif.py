"""EXIF: what a camera wrote into its picture's file: how it was held, and its focal length."""

from dataclasses import dataclass
from math import hypot
from pathlib import Path

import numpy as np

from priors.errors import DataError
from priors.types import Image

ORIENTATION, DETAILS = 0x0112, 0x8769
FOCAL_MM, FOCAL_35MM = 0x920A, 0xA405
X_RESOLUTION, RESOLUTION_UNIT = 0xA20E, 0xA210
TAKEN_SIZE = 0xA002, 0xA003
"""Width and height of the picture when it was taken: a smaller one was resized."""
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}
DIAGONAL_35MM = hypot(36.0, 24.0)
"""Of a 35 mm film's picture, mm: focal lengths "in 35 mm film" compare by the diagonal (CIPA DCG-001)."""


@dataclass(frozen=True)
class Shot:
    """What is known of one picture before its pixels are read."""

    stored: tuple[int, int]
    """(height, width) as the file holds it."""
    orientation: int = 1
    """1 to 8: how the stored picture must be turned and mirrored to be upright; Exif 2.32, tag 0112."""
    focal_px: float | None = None
    """Focal length, px; None where the file does not say it."""

    @property
    def size(self) -> tuple[int, int]:
        """Return (height, width) of the upright picture."""
        height, width = self.stored
        return (width, height) if self.orientation >= 5 else (height, width)

    def upright(self, image: Image) -> Image:
        """Turn and mirror the stored pixels as the orientation says."""
        if self.orientation >= 5:
            image = image.swapaxes(0, 1)
        flips = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}.get(self.orientation, ())
        return np.ascontiguousarray(np.flip(image, flips))


def read_shot(path: Path) -> Shot:
    """Read a picture's header.

    Raises:
        DataError: it is no picture.
    """
    from PIL import Image as Pillow

    try:
        with Pillow.open(path) as picture:
            width, height = picture.size
            tags = picture.getexif()
            details = tags.get_ifd(DETAILS)
    except (OSError, SyntaxError, ValueError) as error:
        raise DataError(f"{path}: damaged image ({error}): take another copy") from error
    orientation = tags.get(ORIENTATION, 1)
    return Shot(
        (height, width), orientation if orientation in range(1, 9) else 1, _focal_px(dict(details), height, width)
    )


def _focal_px(details: dict[int, object], height: int, width: int) -> float | None:
    """Return the focal length, px: by the sensor's resolution where it is told, else by that of 35 mm film."""
    focal_mm, per_unit = _number(details, FOCAL_MM), _number(details, X_RESOLUTION)
    mm = MM_PER_UNIT.get(int(_number(details, RESOLUTION_UNIT) or 2))
    if focal_mm and per_unit and mm:
        taken = max(_number(details, tag) or 0 for tag in TAKEN_SIZE) or max(height, width)
        return focal_mm * per_unit / mm * max(height, width) / taken
    focal_35mm = _number(details, FOCAL_35MM)
    return focal_35mm / DIAGONAL_35MM * hypot(height, width) if focal_35mm else None


def _number(details: dict[int, object], tag: int) -> float | None:
    """Return a tag's number; None where it is missing, no number, or not above 0: 0 stands for "not known"."""
    try:
        number = float(details[tag])  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) and number > 0 else None
