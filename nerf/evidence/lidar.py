"""LiDAR as a witness: by which factor a prior's depths suit the frames' own sweeps."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from priors.methods.lidar import Lidar
from priors.types import Drive

Floats = npt.NDArray[np.float32]
Sweeps: TypeAlias = Callable[[int], Floats | None]
"""Returns the sparse depth (h, w), metres, of a frame's own sweep by the frame's position; None: it has none."""
FEWEST = 100
"""Fewer pixels that both know say nothing."""


def sweeps_of(drive: Drive, ids: list[str]) -> Sweeps | None:
    """Return a drive's sweeps for frames by their positions in `ids`; None where the drive has none."""
    frames = {id_: position for position, id_ in enumerate(drive.ids)}
    if not any(drive[frames[id_]].has("sweep") for id_ in ids):
        return None

    def depth_m(position: int) -> Floats | None:
        frame = drive[frames[ids[position]]]
        if not frame.has("sweep") or frame.sweep() is None:
            return None  # the scanner missed this frame
        return Lidar(sweeps=1).resolve(frame)(frame).depth_m

    return depth_m


def ratios(prior_m: Floats, lidar_m: Floats | None) -> Floats:
    """Return by what a prior's values (h, w), metres, must be multiplied to be the LiDAR's, (n,); empty: too few."""
    if lidar_m is None:
        return np.zeros(0, np.float32)
    both = (prior_m > 0) & (lidar_m > 0)
    return np.asarray(lidar_m[both] / prior_m[both], np.float32) if both.sum() >= FEWEST else np.zeros(0, np.float32)
