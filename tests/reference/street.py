"""Rays against triangles, one by one."""

import numpy as np


def meet(origin, direction, triangles):
    """Return the distance to the first of triangles (n, 3, 3) that a ray meets (in lengths of direction), or inf."""
    nearest = np.inf
    for a, b, c in triangles.astype(np.float64):
        columns = np.stack([b - a, c - a, -np.asarray(direction, np.float64)], axis=1)
        if abs(np.linalg.det(columns)) < 1e-12:
            continue
        u, v, distance = np.linalg.solve(columns, np.asarray(origin, np.float64) - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < distance < nearest:
            nearest = distance
    return nearest
