"""Bare trees drawn before a labelled sky: between their branches it is sky still.

Most labelled trees are in leaf. A network that learned from them takes the whole crown of a bare one for a tree.
"""

from dataclasses import dataclass

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
THINNER = 0.65
"""A branch's thickness against the one that it grows from."""
TRUNK = (0.1, 0.22)
"""Length of a trunk, of the image's height."""
DARK = (8, 110)
"""Levels of bark."""
SUBPIXEL = 3
"""Bits of a coordinate below the pixel."""


@dataclass(frozen=True)
class Branch:
    """A straight piece of a tree, pixels and radians."""

    start: npt.NDArray[np.float64]
    angle: float
    length: float
    thickness: float


def grow_trees(image: Image, label: FloatMap, rng: np.random.Generator) -> tuple[Image, FloatMap]:
    """Return an image (height, width[, 3]) with bare trees, and its labels."""
    cover = np.zeros(label.shape, np.uint8)
    height, width = label.shape
    for _ in range(rng.integers(1, MOST_TREES + 1)):
        foot = np.array([rng.uniform(-0.1, 1.1) * width, rng.uniform(0.25, 0.75) * height])
        length, thickness = rng.uniform(*TRUNK) * height, rng.uniform(0.01, 0.025) * height
        _grow(cover, Branch(foot, -np.pi / 2 + rng.normal() * 0.1, length, thickness), DEPTH, rng)
    cover[label != SKY] = 0
    amount = cover.astype(np.float32) / 255
    bark = rng.uniform(*DARK) * (1 if image.ndim == 2 else rng.uniform(0.8, 1.2, 3))
    share = amount if image.ndim == 2 else amount[..., None]
    drawn = np.clip(image + share * (bark - image), 0, 255).astype(np.uint8)
    return drawn, np.where(amount > 0.5, np.float32(REST), label)


def _grow(cover: Image, branch: Branch, forks: int, rng: np.random.Generator) -> None:
    """Draw a branch and what grows from it."""
    end = branch.start + branch.length * np.array([np.cos(branch.angle), np.sin(branch.angle)])
    points = [tuple(int(value) for value in np.rint(point * 2**SUBPIXEL)) for point in (branch.start, end)]
    cv2.line(cover, points[0], points[1], 255, max(1, round(branch.thickness)), cv2.LINE_AA, SUBPIXEL)
    for _ in range(0 if not forks else 2 if rng.random() < 0.8 else 3):
        angle, length = branch.angle + rng.normal() * SPREAD, branch.length * rng.uniform(*SHRINK)
        _grow(cover, Branch(end, angle, length, THINNER * branch.thickness), forks - 1, rng)
