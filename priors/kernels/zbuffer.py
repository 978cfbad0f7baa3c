"""Z-buffer: LiDAR sweeps are splatted into a depth map, the nearest surface wins."""

import numpy as np
import numpy.typing as npt

from priors.kernels.untwist import move_point
from priors.machine.compiled import compiled


@compiled
def splat(
    xyz_m: npt.NDArray[np.float32],
    time_s: npt.NDArray[np.float32],
    velocity: npt.NDArray[np.float64],
    P: npt.NDArray[np.float64],
    source: int,
    agree: float,
    free_m: npt.NDArray[np.float32],
    depth_m: npt.NDArray[np.float32],
    sources: npt.NDArray[np.int16],
) -> None:
    """Untwist, project and z-buffer one sweep into depth_m and sources (height, width), in place.

    A point takes the pixel where it is nearer than what is there, and not in free space. Where what is there came from
    another sweep, it must be nearer by more than the share `agree`: the sweep splatted first is believed about a
    surface that both saw.

    Args:
        xyz_m: (n, 3) points in the LiDAR's frame; behind the camera, outside the image or not finite: left out.
        time_s: (n,) seconds to the reference time, or (0,) where the points need no untwisting.
        velocity: (6,) ego motion, m/s and rad/s.
        P: (3, 4) LiDAR to pixels: K [R t].
        source: number of this sweep, written to sources where its points win.
        agree: share of the depth within which two sweeps see the same surface.
        free_m: depth (height, width) up to which space is known to be free: nearer points are left out; or (0, 0).
        depth_m: metres; inf where there is no value.
        sources: which sweep each value is from.
    """
    height, width = depth_m.shape
    twisted, bounded = time_s.shape[0] > 0, free_m.shape[0] > 0
    speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    turn = np.sqrt(velocity[3] ** 2 + velocity[4] ** 2 + velocity[5] ** 2)
    behind, left, right = _outside_planes(P, width)
    for i in range(xyz_m.shape[0]):
        x, y, z = float(xyz_m[i, 0]), float(xyz_m[i, 1]), float(xyz_m[i, 2])
        slack = 0.0
        t = 0.0
        if twisted:
            t = float(time_s[i])
            slack = abs(t) * (speed + turn * (abs(x) + abs(y) + abs(z)))
        # Most points are far outside the view: no motion within the sweep brings them in.
        if not behind[0] * x + behind[1] * y + behind[2] * z + behind[3] < slack:
            continue
        if not left[0] * x + left[1] * y + left[2] * z + left[3] < slack:
            continue
        if not right[0] * x + right[1] * y + right[2] * z + right[3] < slack:
            continue
        if twisted:
            x, y, z = move_point(x, y, z, t, velocity)
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if not (depth > 0 and depth < np.inf):
            continue
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth + 0.5
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth + 0.5
        if not (u >= 0 and v >= 0 and u < width and v < height):
            continue
        column, row = int(u), int(v)
        if bounded and depth < free_m[row, column]:
            continue
        limit = depth_m[row, column]
        if sources[row, column] != source:
            limit *= 1.0 - agree
        if depth < limit:
            depth_m[row, column] = depth
            sources[row, column] = source


@compiled
def _outside_planes(P: npt.NDArray[np.float64], width: int) -> npt.NDArray[np.float64]:
    """Return three unit planes (3, 4), positive outside the view: behind it, left of it, right of it."""
    planes = np.empty((3, 4))
    planes[0] = -P[2]
    planes[1] = -0.5 * P[2] - P[0]
    planes[2] = P[0] - (width - 0.5) * P[2]
    for k in range(3):
        planes[k] /= np.sqrt(planes[k, 0] ** 2 + planes[k, 1] ** 2 + planes[k, 2] ** 2)
    return planes
