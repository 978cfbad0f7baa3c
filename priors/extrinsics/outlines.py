"""Outlines in a sweep: the near side of jumps in range from one firing of a laser to the next."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

LINES_APART = 3.0
"""Elevation counts so many times azimuth: neighbours are of one laser's line."""
STEPS = 4
"""How many firings on the next echo is looked for: glass and edges return nothing."""
NEAR_STEP = 0.6
"""Share of a step within which an echo is taken for the one that is looked for."""
FINEST_DEG, COARSEST_DEG = 0.05, 0.5
"""Step between firings: what is outside is no scanner's."""
FARTHER, FARTHER_M = 1.12, 0.4
"""A jump goes on to so many times the range, and so much more."""
BEND = 0.1
"""It leaves the plane through the point and its other neighbour by such a share of the inverse range."""
FEWEST = 50


class Outlines(NamedTuple):
    """Points just outside the near surface, half a step from its last echo, at its range."""

    xyz_m: npt.NDArray[np.float32]
    """(n, 3) in the LiDAR's frame, as measured: not untwisted."""
    side: Floats
    """(n,) which way is out of the surface in the image: -1 left, 1 right."""
    source: Indices
    """(n,) the last echo's place in the sweep."""


def find_outlines(xyz_m: npt.NDArray[np.float32]) -> Outlines:
    """Find the outlines of surfaces in points (n, 3) of a sweep, x forward, y left, z up, metres.

    On a plane inverse range is linear in the angle, near enough: a plane seen at a grazing angle has no outline.
    """
    range_m = np.linalg.norm(xyz_m, axis=1).astype(np.float64)
    if len(xyz_m) < FEWEST:
        return Outlines(np.zeros((0, 3), np.float32), np.zeros(0), np.zeros(0, np.int64))
    azimuth = np.degrees(np.arctan2(xyz_m[:, 1], xyz_m[:, 0])).astype(np.float64)
    elevation = np.degrees(np.arcsin(xyz_m[:, 2] / range_m)).astype(np.float64)
    places = np.stack([azimuth, LINES_APART * elevation], axis=1)
    tree = cKDTree(places)
    step = float(np.clip(np.median(tree.query(places, 2)[0][:, 1]), FINEST_DEG, COARSEST_DEG))
    beside = {side: _next_echo(tree, places, -side * step) for side in (-1, 1)}  # azimuth grows to the left
    parts = []
    for side in (-1, 1):
        own = _jumps(1 / range_m, azimuth, beside[side], beside[-side])
        gap = np.clip(azimuth[beside[side][own]] - azimuth[own], -step, step)
        parts.append((_directions(azimuth[own] + gap / 2, elevation[own]) * range_m[own, None], side, own))
    points = np.concatenate([xyz for xyz, _, _ in parts]).astype(np.float32)
    sides = np.concatenate([np.full(len(own), float(side)) for _, side, own in parts])
    return Outlines(points, sides, np.concatenate([own for _, _, own in parts]))


def _next_echo(tree: cKDTree, places: Floats, step: float) -> Indices:
    """Return for each point the next echo of its line, (n,) indices, a step away or a few; -1 where there is none."""
    found = np.full(len(places), -1)
    for count in range(1, STEPS + 1):
        open_ = np.flatnonzero(found < 0)
        wanted = places[open_] + np.array([count * step, 0.0])
        distance, index = tree.query(wanted, distance_upper_bound=NEAR_STEP * abs(step))
        there = np.isfinite(distance) & (index != open_)
        found[open_[there]] = index[there]
    return found


def _jumps(inverse: Floats, azimuth: Floats, ahead: Indices, behind: Indices) -> Indices:
    """Return which points are the near side of a jump to the echo ahead, by inverse ranges (n,), 1 / m."""
    own = np.flatnonzero(ahead >= 0)
    to, back = ahead[own], behind[own]
    slope = (inverse[own] - inverse[back]) / np.maximum(np.abs(azimuth[own] - azimuth[back]), FINEST_DEG)
    slope = np.where(back >= 0, np.minimum(slope, 0), 0)  # a plane that comes nearer predicts no fall
    expected = inverse[own] + slope * np.abs(azimuth[to] - azimuth[own])
    jump = 1 / inverse[to] > FARTHER / inverse[own] + FARTHER_M
    jump &= inverse[to] < expected - BEND * inverse[own]
    return np.asarray(own[jump])


def _directions(azimuth: Floats, elevation: Floats) -> Floats:
    """Return unit vectors (n, 3) of directions in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
