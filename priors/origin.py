"""Origin: what is taken off a drive's positions, in float64, before anything becomes float32.

Maps have positions like (455000, 5428000, 110) m, where neighbouring float32 numbers lie 0.5 m apart. A scene's frame
is therefore the drive's, moved by a whole number of metres; files and new poses are in the drive's own frame.
"""

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Offset: TypeAlias = tuple[float, float, float]
"""Metres along the world's axes."""
Poses = npt.NDArray[np.floating[Any]]

NONE: Offset = (0.0, 0.0, 0.0)
FAR_M = 1000.0
"""A path that comes no farther than this from the world's origin stays as it is: float32 resolves 0.06 mm there."""


def origin_of(T_world_cam: Poses) -> Offset:
    """Choose the origin of poses (n, 4, 4): the middle of a far path in whole metres, NONE for a near one.

    Whole metres are taken off and put back without rounding, and they are short to write down.
    """
    positions_m = np.asarray(T_world_cam, dtype=np.float64)[:, :3, 3]
    if not len(positions_m) or np.abs(positions_m).max() <= FAR_M:
        return NONE
    middle_m = np.rint((positions_m.min(axis=0) + positions_m.max(axis=0)) / 2)
    return float(middle_m[0]), float(middle_m[1]), float(middle_m[2])


def without(origin_m: Offset, T_world_cam: Poses) -> npt.NDArray[np.float64]:
    """Return poses (..., 4, 4) of the drive's frame in the frame of an origin."""
    poses = np.array(T_world_cam, dtype=np.float64)
    poses[..., :3, 3] -= origin_m
    return poses


def put_back(origin_m: Offset, T_world_cam: Poses) -> npt.NDArray[np.float64]:
    """Return poses (..., 4, 4) of an origin's frame in the drive's own: what undoes `without`."""
    return without((-origin_m[0], -origin_m[1], -origin_m[2]), T_world_cam)


def told(origin_m: Offset) -> str:
    """Write an origin for people: (455000, 5428001, 110)."""
    return f"({', '.join(f'{value:.0f}' for value in origin_m)})"
