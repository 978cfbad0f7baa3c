"""Flicker: how much a prior's depth of one point of the scene differs from one frame to the next.

A pixel of one frame is paired with the place in the other where its point is seen. The truth pairs them, so every prior
is asked about the same points. A point counts where the truth of both frames agrees on it: what moves by itself, and
what is hidden from the other view, is left out. A prior's value is carried over by the poses, and compared:

    flicker = median over the points of |ln(z_warped / z)|

z is read between four pixels in inverse depth, which is linear on a plane; at edges it is the nearest pixel's.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eval.depth import FloatArray, has_value

STATIC = 0.05
"""Share of the depth within which the truth of both frames is the same surface."""
ONE_SURFACE = 0.05
"""Four pixels are of one surface where their inverse depths lie within this share of each other."""
Flat = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class View:
    """One frame of a drive."""

    depth_m: FloatArray
    """(height, width) a prior's map, metres; 0 = no value."""
    truth_m: FloatArray
    """(height, width) metres; 0 = no value."""
    K: Flat
    """(3, 3) pixels; the centre of the top-left pixel is (0, 0)."""
    T_world_cam: Flat
    """(4, 4)."""


def flicker(here: View, there: View) -> float:
    """Return the flicker of a prior between two frames; NaN where no point has all that it takes."""
    differences = log_differences(here, there)
    return float(np.median(differences)) if differences.size else float("nan")


def log_differences(here: View, there: View) -> Flat:
    """Return |ln(z_warped / z)| (n,) of the points that both frames see, and for which the prior has both values."""
    T = np.linalg.inv(there.T_world_cam) @ here.T_world_cam
    rows, columns = np.nonzero(has_value(here.truth_m) & has_value(here.depth_m))
    pixels = np.stack([columns, rows, np.ones(len(rows))]).astype(np.float64)
    rays = np.linalg.solve(here.K, pixels)
    true = _move(T, rays * here.truth_m[rows, columns])
    own = _move(T, rays * here.depth_m[rows, columns])
    true, own = (points[:, (true[2] > 0) & (own[2] > 0)] for points in (true, own))
    u, v = (there.K @ true)[:2] / true[2]
    height, width = there.truth_m.shape
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    u, v, true_m, own_m = u[inside], v[inside], true[2, inside], own[2, inside]
    seen_m, found_m = read_between(there.truth_m, u, v), read_between(there.depth_m, u, v)
    with np.errstate(divide="ignore"):
        same = (seen_m > 0) & (found_m > 0) & (np.abs(np.log(seen_m / true_m)) < STATIC)
    return np.abs(np.log(own_m[same] / found_m[same]))


def read_between(depth_m: FloatArray, u: Flat, v: Flat) -> Flat:
    """Return the depth (n,) at places inside a map, metres: bilinear in inverse depth on one surface, else the nearest.

    It is 0 where the nearest pixel has no value.
    """
    height, width = depth_m.shape
    valued = has_value(depth_m)
    inverse = np.zeros(depth_m.shape)
    inverse[valued] = 1 / depth_m[valued].astype(np.float64)
    left, top = np.minimum(u.astype(int), max(width - 2, 0)), np.minimum(v.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    four = np.stack([inverse[top, left], inverse[top, right], inverse[bottom, left], inverse[bottom, right]])
    a, b = u - left, v - top
    between = np.sum(four * np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b]), axis=0)
    nearest = inverse[np.rint(v).astype(int), np.rint(u).astype(int)]
    plain = four.min(axis=0) >= four.max(axis=0) * (1 - ONE_SURFACE)
    chosen = np.where(plain, between, nearest)
    return np.divide(1.0, chosen, out=np.zeros_like(chosen), where=nearest > 0)


def _move(T: Flat, points: Flat) -> Flat:
    """Map points (3, n)."""
    return np.asarray(T[:3, :3] @ points + T[:3, 3:])
