"""Bare trees drawn before a labelled sky: between their branches it is sky still.

Most labelled trees are in leaf. A network that learned from them takes the whole crown of a bare one for a tree.
"""

import cv2
import numpy as np
import numpy.typing as npt

from priors.learn.sky_labels import REST, SKY
from priors.types import FloatMap, Image

MOST_TREES = 4
DEPTH = 7
"""Times that a branch forks."""
SHRINK, SPREAD = (0.68, 0.9), 0.45
"""A branch's length against the one that it grows from, and the angle between them, radians (deviation)."""
TRUNK = (0.1, 0.22)
"""Length of a trunk, of the image's height."""
DARK = (8, 110)
"""Levels of bark."""
SUBPIXEL = 3
"""Bits of a coordinate below the pixel."""


def grow_trees(image: Image, label: FloatMap, rng: np.random.Generator) -> tuple[Image, FloatMap]:
    """Return an image (height, width[, 3]) with bare trees, and its labels."""
    cover = np.zeros(label.shape, np.uint8)
    height, width = label.shape
    for _ in range(rng.integers(1, MOST_TREES + 1)):
        foot = np.array([rng.uniform(-0.1, 1.1) * width, rng.uniform(0.25, 0.75) * height])
        length = rng.uniform(*TRUNK) * height
        _grow(cover, foot, -np.pi / 2 + rng.normal() * 0.1, length, rng.uniform(0.02, 0.05) * height / 2, DEPTH, rng)
    cover[label != SKY] = 0
    amount = cover.astype(np.float32) / 255
    bark = rng.uniform(*DARK) * (1 if image.ndim == 2 else rng.uniform(0.8, 1.2, 3))
    share = amount if image.ndim == 2 else amount[..., None]
    drawn = np.clip(image + share * (bark - image), 0, 255).astype(np.uint8)
    return drawn, np.where(amount > 0.5, np.float32(REST), label)


def _grow(
    cover: Image,
    start: npt.NDArray[np.float64],
    angle: float,
    length: float,
    thickness: float,
    left: int,
    rng: np.random.Generator,
) -> None:
    end = start + length * np.array([np.cos(angle), np.sin(angle)])
    points = [tuple(int(value) for value in np.rint(point * 2**SUBPIXEL)) for point in (start, end)]
    cv2.line(cover, points[0], points[1], 255, max(1, round(thickness)), cv2.LINE_AA, SUBPIXEL)
    if left:
        for _ in range(2 if rng.random() < 0.8 else 3):
            way = angle + rng.normal() * SPREAD
            _grow(cover, end, way, length * rng.uniform(*SHRINK), 0.65 * thickness, left - 1, rng)
