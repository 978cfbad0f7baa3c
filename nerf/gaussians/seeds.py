"""Seeds: the Gaussians that a fit starts from, as discs that lie on surfaces."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from nerf.gaussians.look import Look
from priors.geometry import rays

Floats = npt.NDArray[np.float32]

WIDTH = 0.6
"""Standard deviation of a disc across the line of sight, as a share of its cell."""
MOST_STRETCH = 3.0
"""A disc that is seen at a low angle is at most so many times as long as it is wide."""
THICKNESS = 0.15
"""Standard deviation along the normal, as a share of the width."""


@dataclass(frozen=True, slots=True)
class Seeds:
    """Discs, (n, ...) float32, in the scene's frame."""

    means_m: Floats
    """(n, 3)"""
    log_scales: Floats
    """(n, 3) log of the standard deviations along the disc's axes, metres."""
    rotations: Floats
    """(n, 4) unit quaternions w x y z: the axes are the columns of the matrix."""
    rgb: Floats
    """(n, 3) in [0, 1]."""
    cell_m: Floats
    """(n,) width of the image's cell at the disc: what is small there, metres."""

    def __len__(self) -> int:
        return len(self.means_m)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join seeds; none make none."""
        empty = cls(*(np.zeros((0, *shape), np.float32) for shape in ((3,), (3,), (4,), (3,), ())))
        every = [empty, *parts]
        return cls(*(np.concatenate([getattr(part, field.name) for part in every]) for field in fields(cls)))


class Lattice:
    """A frame's candidates: the middle pixel of each cell of step x step pixels."""

    def __init__(self, look: Look, step: int) -> None:
        self.look, self.step = look, step
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        directions = rays(look.camera)[self._grid]
        self._in_camera = (directions * look.depth_m[self._grid][..., None]).astype(np.float32)
        rotation, place = look.T_world_cam[:3, :3], look.T_world_cam[:3, 3]
        self.means_m = (self._in_camera @ rotation.T + place).astype(np.float32)
        """(rows, columns, 3)"""
        self.usable, self.sky = look.usable[self._grid], look.sky[self._grid]
        self.trust = look.trust[self._grid]

    def seeds(self, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> Seeds:
        """Make discs of the candidates at rows (n,) and columns (n,)."""
        in_camera, look = self._in_camera[rows, columns], self.look
        normal = look.normals[self._grid][rows, columns]
        colours = cv2.blur(look.image, (self.step, self.step))[self._grid][rows, columns]
        cell_m = (self.step * in_camera[:, 2] / look.camera.fx).astype(np.float32)
        axes, stretch = disc_axes(in_camera, normal)
        width = WIDTH * cell_m
        scales = np.stack([width * stretch, width, THICKNESS * width], axis=1)
        turned = look.T_world_cam[:3, :3] @ axes
        return Seeds(
            self.means_m[rows, columns],
            np.log(scales).astype(np.float32),
            quaternions(turned).astype(np.float32),
            (colours / np.float32(255)).astype(np.float32),
            cell_m,
        )


def disc_axes(points: Floats, normals: Floats) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Lay discs on a surface at points (n, 3) with unit normals (n, 3), in the camera's frame.

    Returns:
        the axes as columns (n, 3, 3): along the slope, across it, along the normal; and how many times as long as wide
        a disc is so that it looks round (n,).
    """
    sight = points / np.linalg.norm(points, axis=1, keepdims=True)
    cosine = np.sum(sight * normals, axis=1, keepdims=True)
    along = sight - cosine * normals
    length = np.linalg.norm(along, axis=1, keepdims=True)
    other = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    along = np.where(length > 1e-4, along / np.maximum(length, 1e-20), other / np.linalg.norm(other, axis=1)[:, None])
    across = np.cross(normals, along)
    stretch = np.minimum(1 / np.maximum(np.abs(cosine[:, 0]), 1e-6), MOST_STRETCH)
    return np.stack([along, across, normals], axis=-1).astype(np.float64), stretch


def quaternions(matrices: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return unit quaternions (n, 4) w x y z of rotation matrices (n, 3, 3); scipy would first make them orthogonal."""
    a, b, c = matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 2, 2]
    squares = np.stack([1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c], axis=1)
    found = np.sqrt(np.maximum(squares, 0))
    for axis, (low, high) in enumerate(((2, 1), (0, 2), (1, 0)), 1):
        found[:, axis] = np.copysign(found[:, axis], matrices[:, low, high] - matrices[:, high, low])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))
