"""LiDAR dropout for training completion: which points of a scene are shown, and the truth that judges the network."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors.learn.lidar_scene import TRUTH_REACH_M, LidarScene, Points, splat
from priors.methods.lidar import hidden
from priors.types import FloatMap, Mask

COVERED_PX = (15, 9)
"""Rows and columns around LiDAR samples for which official truth has values: 11 sweeps fill the gaps of one."""
ASIDE = 0.05
"""Weight of the truth elsewhere: a scanner does not see it, but users do."""
RAGGED, AT_EDGES = 1.1, 0.35
"""Weight of truth whose 5x5 pixels differ by more than a ratio: leaves, outlines; official truth has fewer of them."""
BEAMS = 64


@dataclass(frozen=True, slots=True)
class CompletionExample:
    """A scene with some of its points shown, and the truth to judge by."""

    scene: LidarScene
    sparse_m: FloatMap
    truth_m: FloatMap
    weight: FloatMap
    """(h, w) in [0, 1], 0 where there is no truth."""


def drop_points(scene: LidarScene, rng: np.random.Generator, every: int | None = None) -> CompletionExample:
    """Choose which points are shown: each `every`-th scan line; None: also random points, fewer of them, or holes."""
    kept = scene.beam % every == 0 if every else _draw_kept(scene, rng)
    points_m = scene.points_m
    if not scene.real and not every and rng.random() < 0.5:
        points_m = _misplace(points_m, rng)
    sparse_m = splat(points_m[kept], scene.camera)
    every_m = splat(scene.points_m, scene.camera)
    if scene.real:
        every_m[hidden(np.where(every_m > 0, every_m, np.float32(np.inf)), scene.camera.fx)] = 0
        unseen_m = np.where(sparse_m > 0, np.float32(0), every_m)
        truth_m = np.where(unseen_m > 0, unseen_m, scene.truth_m)
        return CompletionExample(scene, sparse_m, truth_m, (truth_m > 0).astype(np.float32))
    around = np.ones((2 * COVERED_PX[0] + 1, 2 * COVERED_PX[1] + 1), np.uint8)
    covered = cv2.dilate((every_m > 0).astype(np.uint8), around) > 0
    weight = np.where(covered, np.float32(1), np.float32(ASIDE)) * (scene.truth_m > 0)
    weight[_ragged(scene.truth_m)] *= AT_EDGES
    return CompletionExample(scene, sparse_m, scene.truth_m, weight.astype(np.float32))


def _ragged(truth_m: FloatMap) -> Mask:
    """Tell where surfaces of different depth meet (h, w)."""
    window = np.ones((5, 5), np.uint8)
    nearest = cv2.erode(np.where(truth_m > 0, truth_m, np.float32(TRUTH_REACH_M)), window)
    return cv2.dilate(truth_m, window) > RAGGED * nearest


def _draw_kept(scene: LidarScene, rng: np.random.Generator) -> Mask:
    """Draw which points are shown (n,)."""
    points_m, beam, count = scene.points_m, scene.beam, len(scene.points_m)
    if rng.random() < 0.12:
        wanted = np.exp(rng.uniform(np.log(30), np.log(3000)))
        return rng.random(count) < wanted / max(count, 1)
    every = int(rng.choice([1, 2, 4, 8], p=[0.6, 0.2, 0.12, 0.08]))
    kept = beam % every == rng.integers(every)
    if rng.random() < 0.3:
        kept &= rng.random(count) < rng.uniform(0.3, 1)
    if scene.real and rng.random() < 0.4:
        kept &= ~_gaps(points_m, beam, rng)
    elif rng.random() < 0.3:
        kept &= ~_holes(points_m, rng)
    return kept


def _gaps(points_m: Points, beam: npt.NDArray[np.uint8], rng: np.random.Generator) -> Mask:
    """Tell which points lie on pieces of scan lines that are left out, as truth between two shown lines."""
    sector = np.floor(np.arctan2(points_m[:, 0], points_m[:, 2]) / 0.12 + rng.random()).astype(np.intp)
    out = rng.random((BEAMS, sector.max(initial=0) - sector.min(initial=0) + 1)) < 0.25
    return out[beam, sector - sector.min(initial=0)] | (rng.random(len(beam)) < 0.08)


def _holes(points_m: Points, rng: np.random.Generator) -> Mask:
    """Tell which points lie in a few cones that return nothing: windows, wet or dark paint."""
    ray = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    out = np.zeros(len(points_m), bool)
    for _ in range(rng.integers(1, 6)):
        if len(ray):
            out |= ray @ ray[rng.integers(len(ray))] > np.cos(rng.uniform(0.01, 0.07))
    return out


def _misplace(points_m: Points, rng: np.random.Generator) -> Points:
    """Turn and shift points as a calibration that is a pixel off, and a car that moved meanwhile, do."""
    turn = np.eye(3) + np.cross(np.eye(3), rng.normal(0, 7e-4, 3))
    moved: Points = (points_m @ turn.T + rng.normal(0, 0.015, 3)).astype(np.float32)
    return moved
