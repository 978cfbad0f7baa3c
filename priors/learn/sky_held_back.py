"""Sky of KITTI 2015's held-back images, outlined by hand: the mask is judged on them, nothing learns from them.

A polygon says where sky may be, blue above a level which of its pixels are sky. A band along the polygon's sides is
left open, as are places between the two levels.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from priors.codecs import read_image
from priors.learn.sky_labels import REST, SKY, UNKNOWN, SkySample
from priors.types import FloatMap, Image

PLACE = "kitti2015 held back"
IMAGES = Path("kitti_stereo2015/training/image_2")
SKY_BLUE, DARK_BLUE = 165, 120
"""Blue, 0 to 255, above which a pixel of a polygon is sky, and below which it is not."""
BAND_PX = 12
"""So close to a polygon's line that is no edge of the image, what is not dark is not known."""
POLYGONS: dict[int, tuple[tuple[int, int], ...]] = {
    22: ((400, 0), (1180, 0), (1180, 110), (600, 110), (600, 62), (520, 62), (520, 110), (400, 110)),
    23: ((180, 0), (1241, 0), (1241, 150), (1000, 110), (180, 110)),
    24: ((0, 0), (1165, 0), (1165, 60), (1020, 100), (920, 155), (780, 155), (770, 130), (0, 110)),
    25: ((0, 0), (850, 0), (850, 25), (640, 110), (600, 145), (520, 155), (420, 150), (380, 130), (200, 90), (0, 60)),
    38: ((0, 0), (1241, 0), (1241, 148), (700, 148), (660, 140), (550, 140), (500, 150), (350, 140), (0, 100)),
    39: ((0, 0), (1241, 0), (1241, 140), (720, 144), (690, 130), (650, 138), (520, 136), (480, 135), (0, 100)),
    40: ((0, 0), (1241, 0), (1241, 125), (1100, 140), (660, 142), (640, 128), (540, 130), (500, 125), (0, 100)),
    41: ((0, 0), (1241, 0), (1241, 120), (1160, 128), (1000, 136), (660, 138), (640, 128), (520, 128), (0, 100)),
    69: ((440, 0), (650, 0), (640, 30), (600, 75), (540, 110), (525, 125), (515, 40), (480, 5)),
    70: ((50, 0), (960, 0), (915, 60), (830, 110), (830, 140), (100, 130), (110, 60), (60, 20)),
    71: ((0, 0), (1241, 0), (1241, 60), (1150, 80), (700, 100), (0, 98)),
    72: ((0, 0), (1241, 0), (1241, 135), (640, 140), (520, 140), (500, 125), (0, 110)),
    125: (
        *((320, 0), (740, 0), (715, 60), (720, 115), (700, 100), (655, 90), (580, 76), (560, 92), (530, 88)),
        *((500, 70), (490, 30), (450, 25), (440, 35), (410, 35)),
    ),
    126: (
        *((450, 0), (775, 0), (750, 60), (765, 105), (740, 105), (700, 80), (660, 76), (590, 68), (565, 85)),
        *((530, 70), (500, 58), (475, 40)),
    ),
    127: (
        *((455, 0), (830, 0), (810, 60), (815, 105), (790, 110), (770, 80), (710, 76), (650, 70), (620, 58), (590, 66)),
        *((570, 48), (550, 60), (500, 48), (480, 20)),
    ),
    128: ((430, 0), (700, 0), (640, 60), (620, 130), (540, 125), (500, 90), (430, 40)),
}
"""Polygons by the image's number: (x, y), pixels."""
OPEN: dict[int, tuple[int, int, int, int]] = {
    22: (1165, 0, 1242, 60),
    23: (0, 0, 180, 115),
    25: (78, 10, 96, 120),
    38: (752, 78, 818, 145),
    72: (668, 85, 772, 150),
    125: (825, 0, 990, 70),
    126: (930, 0, 1010, 40),
}
"""Boxes (left, top, right, bottom) in which nothing is known: signs, or sky that no polygon has."""


def read_held_back(data: Path) -> Iterator[SkySample]:
    """Read the outlined images."""
    for number in POLYGONS:
        image = read_image(data / IMAGES / f"{number:06}_10.jpg")
        yield SkySample(PLACE, image, label(image, number))


def label(image: Image, number: int) -> FloatMap:
    """Label an image (height, width, 3) by its outline."""
    inside, line = np.zeros(image.shape[:2], np.uint8), np.zeros(image.shape[:2], np.uint8)
    outline = np.array(POLYGONS[number], np.int32)
    cv2.fillPoly(inside, [outline], 1)
    for (x, y), (to_x, to_y) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y > 0 or to_y > 0:
            cv2.line(line, (int(x), int(y)), (int(to_x), int(to_y)), 1, 2 * BAND_PX + 1)
    blue = cv2.GaussianBlur(image[..., 2], (3, 3), 0)
    out = np.where((inside > 0) & (blue > SKY_BLUE), SKY, REST).astype(np.float32)
    out[(inside > 0) & (blue > DARK_BLUE) & (blue <= SKY_BLUE)] = UNKNOWN
    out[(line > 0) & (blue > DARK_BLUE)] = UNKNOWN
    if number in OPEN:
        left, top, right, bottom = OPEN[number]
        out[top:bottom, left:right] = UNKNOWN
    return out
