"""Surface: a training frame's prior as the warp draws it, complete, with its tears."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.warp_draw import ALONE, SQUARE
from nerf.warp.fill import fill

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]

TEAR = np.float32(0.2)
"""Neighbours whose inverse depths differ by less than this share of the larger are one surface."""
PLANAR = np.float32(0.5)
"""So are those that differ as much as the next pair does, give or take this share: a road seen at a low angle."""
FILLED_TRUST = np.float32(0.1)
"""How much a depth counts that was filled in."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A frame's depth, ready to be drawn."""

    inverse: Floats
    """(h, w) inverse depth, 1/m, everywhere."""
    trust: Floats
    """(h, w) how much it counts, [0, 1]."""
    joins: npt.NDArray[np.uint8]
    """(h, w) which pixels are one surface: nerf.kernels.cpu.warp_draw."""


def surface_of(depth_m: Floats, weight: npt.NDArray[np.uint8] | None) -> Surface:
    """Complete a prior's map (h, w), metres, 0 = no value, with its confidence x 255, and find its tears.

    What has no value is filled in from around, in inverse depth: LiDAR has a value for one pixel in ten.
    """
    known = (depth_m > 0) & np.isfinite(depth_m)
    sparse = np.divide(np.float32(1), depth_m, out=np.zeros_like(depth_m), where=known)
    inverse = fill(sparse, known)
    confidence = np.float32(1) if weight is None else weight / np.float32(255)
    trust = np.where(known, confidence, FILLED_TRUST).astype(np.float32)
    return Surface(inverse, trust, joins_of(inverse))


def joins_of(inverse: Floats) -> npt.NDArray[np.uint8]:
    """Tell which pixels of inverse depths (h, w) form one surface."""
    across, down = _joined(inverse), _joined(inverse.T).T
    square = np.zeros(inverse.shape, dtype=bool)
    square[:-1, :-1] = across[:-1] & across[1:] & down[:, :-1] & down[:, 1:]
    padded = np.pad(square, ((1, 0), (1, 0)))
    around = padded[1:, 1:] & padded[:-1, 1:] & padded[1:, :-1] & padded[:-1, :-1]
    return (square * SQUARE + ~around * ALONE).astype(np.uint8)


def _joined(inverse: Floats) -> Flags:
    """Tell which neighbours in a row are of one surface: (h, w - 1)."""
    step = np.diff(inverse, axis=1)
    small = np.abs(step) <= TEAR * np.maximum(inverse[:, :-1], inverse[:, 1:])
    padded = np.pad(step, ((0, 0), (1, 1)), constant_values=np.inf)
    unlike = np.minimum(np.abs(padded[:, :-2] - step), np.abs(padded[:, 2:] - step))
    return small | (unlike <= PLANAR * np.abs(step))
