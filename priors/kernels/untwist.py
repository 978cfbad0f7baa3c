"""Untwisting (deskewing) of a LiDAR sweep: its points are moved along the ego motion, one by one."""

import math

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled

SERIES_BELOW = 0.01  # rad^2: there the series below is exact to 1e-9, and a sweep rarely turns by more


@compiled(inline="always")
def move_point(x: float, y: float, z: float, t: float, velocity: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    """Return Exp(t * angular) p + t * linear; velocity (6,) is linear, then angular (Rodrigues' formula)."""
    a, b, c = t * velocity[3], t * velocity[4], t * velocity[5]
    angle2 = a * a + b * b + c * c
    if angle2 < SERIES_BELOW:
        first = 1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0)
        second = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0)
    else:
        angle = math.sqrt(angle2)
        first = math.sin(angle) / angle
        second = (1.0 - math.cos(angle)) / angle2
    # w x p, and w x (w x p)
    px, py, pz = b * z - c * y, c * x - a * z, a * y - b * x
    qx, qy, qz = b * pz - c * py, c * px - a * pz, a * py - b * px
    return (
        x + first * px + second * qx + t * velocity[0],
        y + first * py + second * qy + t * velocity[1],
        z + first * pz + second * qz + t * velocity[2],
    )


@compiled
def untwist_points(
    xyz_m: npt.NDArray[np.float32], time_s: npt.NDArray[np.float32], velocity: npt.NDArray[np.float64]
) -> npt.NDArray[np.float32]:
    """Return the points (n, 3) moved by `move_point`, each by its own time."""
    out = np.empty_like(xyz_m)
    for i in range(xyz_m.shape[0]):
        x, y, z = move_point(xyz_m[i, 0], xyz_m[i, 1], xyz_m[i, 2], time_s[i], velocity)
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
    return out
