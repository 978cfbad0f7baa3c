"""LiDAR dropout for training completion: which points of a scene are shown, and the truth that judges the network."""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.geometry import rays
from priors.learn.accumulated_lidar import INPUTS
from priors.learn.lidar_scene import TRUTH_REACH_M, LidarScene, Points, splat
from priors.learn.real_truth import KITTI2015
from priors.learn.scan_lines import met
from priors.methods.lidar import hidden
from priors.types import FloatMap, Mask, Matrix

COVERED_PX = (15, 9)
"""Rows and columns around LiDAR samples for which official truth has values: 11 sweeps fill the gaps of one."""
ASIDE = 0.05
"""Weight of the truth elsewhere: a scanner does not see it, but users do."""
RAGGED, AT_EDGES = 1.1, 0.35
"""Weight of truth whose 5x5 pixels differ by more than a ratio: leaves, outlines; official truth has fewer of them."""
BEAMS = 64
ACCUMULATED = 0.35
"""Share of the scenes that are shown as several sweeps, where they can be."""
STEP_M = 0.1, 1.5
"""How far a street's scanner drives from one sweep to the next."""
CLEANED = 0.7
"""Share of a street's accumulated maps that went through the lidar method's test of what is hidden."""


@dataclass(frozen=True, slots=True)
class Density:
    """How much of a scene is shown."""

    every: int = 1
    """Every how many-th scan line."""
    points: int | None = None
    """About so many random points of the sweep, not lines."""
    sweeps: int = 1
    """How many sweeps are accumulated."""

    @classmethod
    def accumulated(cls, sweeps: int) -> Self:
        """Return the density of so many sweeps."""
        return cls(sweeps=sweeps)

    def __str__(self) -> str:
        """Return what it is called in figures."""
        if self.sweeps > 1:
            return f"{self.sweeps}sweeps"
        return f"{self.points}points" if self.points else f"{BEAMS // self.every}lines"


@dataclass(frozen=True, slots=True)
class CompletionExample:
    """A scene with some of its points shown, and the truth to judge by."""

    scene: LidarScene
    sparse_m: FloatMap
    truth_m: FloatMap
    weight: FloatMap
    """(h, w) in [0, 1], 0 where there is no truth."""
    T_cam_lidar: Matrix | None
    """Where the scanner stood that saw the samples; None where there were several places."""


def drop_points(scene: LidarScene, rng: np.random.Generator, density: Density | None = None) -> CompletionExample:
    """Choose what is shown of a scene: so much of it; None: anything from 30 points to eleven sweeps, and holes."""
    drawn = density or _draw_density(scene, rng)
    if drawn.sweeps > 1:
        return accumulate(scene, rng, drawn.sweeps)
    kept, points_m = _kept(scene, rng, drawn), scene.points_m
    if density is None:
        kept &= ~_lost(scene, rng)
        points_m = points_m if scene.real or rng.random() < 0.5 else misplace(points_m, rng)
    sparse_m, truth_m = splat(points_m[kept], scene.camera), scene.truth_m
    if scene.real:
        unseen_m = np.where(sparse_m > 0, np.float32(0), own_m(scene))
        official = scene.source == KITTI2015  # what its makers cleaned away is no truth
        truth_m = truth_m if official else np.where(unseen_m > 0, unseen_m, truth_m)
    return _example(scene, sparse_m, truth_m, scene.T_cam_lidar)


def accumulate(scene: LidarScene, rng: np.random.Generator, sweeps: int) -> CompletionExample:
    """Show what several sweeps saw: a real drive's own maps without pieces of its own lines, which are the truth.

    A street's other sweeps are those of a scanner that was ahead or behind, by its dense truth.
    """
    if not scene.real:
        return _example(scene, _drive_on(scene, rng, sweeps), scene.truth_m, None)
    sparse_m = scene.accumulated_m[min(scene.accumulated_m, key=lambda count: abs(count - sweeps))].copy()
    out = _gaps(scene.points_m, scene.beam, rng)
    held_out_m = np.where(splat(scene.points_m[out], scene.camera) > 0, own_m(scene), np.float32(0))
    sparse_m[held_out_m > 0] = 0
    return _example(scene, sparse_m, held_out_m, None)


def own_m(scene: LidarScene) -> FloatMap:
    """Return all own points as a sparse map (h, w), without those that lie inside a nearer surface's outline."""
    every_m = splat(scene.points_m, scene.camera)
    every_m[hidden(np.where(every_m > 0, every_m, np.float32(np.inf)), scene.camera.fx)] = 0
    return every_m


def _example(scene: LidarScene, sparse_m: FloatMap, truth_m: FloatMap, T_cam_lidar: Matrix | None) -> CompletionExample:
    """Weigh the truth: a street's counts where official truth would have values."""
    if scene.real:
        return CompletionExample(scene, sparse_m, truth_m, (truth_m > 0).astype(np.float32), T_cam_lidar)
    around = np.ones((2 * COVERED_PX[0] + 1, 2 * COVERED_PX[1] + 1), np.uint8)
    covered = cv2.dilate((own_m(scene) > 0).astype(np.uint8), around) > 0
    weight = np.where(covered, np.float32(1), np.float32(ASIDE)) * (truth_m > 0)
    weight[_ragged(truth_m)] *= AT_EDGES
    return CompletionExample(scene, sparse_m, truth_m, weight.astype(np.float32), T_cam_lidar)


def _drive_on(scene: LidarScene, rng: np.random.Generator, sweeps: int) -> FloatMap:
    """Sample a street's truth by the scan lines of a scanner that drives on, and by its own points (h, w)."""
    step_m = rng.uniform(*STEP_M)
    points_m = [scene.points_m]
    xyz_m = (rays(scene.camera) * scene.truth_m[..., None]).astype(np.float32)
    for number in range(sweeps):
        offset = number - sweeps // 2
        if offset:
            T_cam_lidar = scene.T_cam_lidar.copy()
            T_cam_lidar[2, 3] += offset * step_m
            points_m.append(misplace(xyz_m[met(scene.truth_m, scene.camera, T_cam_lidar, rng.random())], rng))
    sparse_m = splat(np.concatenate(points_m), scene.camera)
    if rng.random() < CLEANED:
        sparse_m[hidden(np.where(sparse_m > 0, sparse_m, np.float32(np.inf)), scene.camera.fx)] = 0
    return sparse_m


def _ragged(truth_m: FloatMap) -> Mask:
    """Tell where surfaces of different depth meet (h, w)."""
    window = np.ones((5, 5), np.uint8)
    nearest = cv2.erode(np.where(truth_m > 0, truth_m, np.float32(TRUTH_REACH_M)), window)
    return cv2.dilate(truth_m, window) > RAGGED * nearest


def _draw_density(scene: LidarScene, rng: np.random.Generator) -> Density:
    """Draw how much is shown of a scene."""
    if rng.random() < ACCUMULATED and (scene.accumulated_m or not scene.real):
        return Density(sweeps=int(rng.choice(INPUTS)))
    if rng.random() < 0.12:
        return Density(points=round(np.exp(rng.uniform(np.log(30), np.log(3000)))))
    return Density(int(rng.choice([1, 2, 4, 8], p=[0.6, 0.2, 0.12, 0.08])))


def _kept(scene: LidarScene, rng: np.random.Generator, density: Density) -> Mask:
    """Choose which points of the own sweep are shown (n,)."""
    if density.points:
        count = len(scene.points_m)
        return rng.random(count) < density.points / max(count, 1)
    return np.asarray(scene.beam % density.every == 0)


def _lost(scene: LidarScene, rng: np.random.Generator) -> Mask:
    """Draw which points of the own sweep never came (n,)."""
    points_m, beam, lost = scene.points_m, scene.beam, np.zeros(len(scene.points_m), bool)
    if rng.random() < 0.3:
        lost |= rng.random(len(beam)) > rng.uniform(0.3, 1)
    if scene.real and rng.random() < 0.4:
        lost |= _gaps(points_m, beam, rng)
    elif rng.random() < 0.3:
        lost |= _holes(points_m, rng)
    return lost


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


def misplace(points_m: Points, rng: np.random.Generator) -> Points:
    """Turn and shift points as a calibration that is a pixel off, and a car that moved meanwhile, do."""
    turn = np.eye(3) + np.cross(np.eye(3), rng.normal(0, 7e-4, 3))
    moved: Points = (points_m @ turn.T + rng.normal(0, 0.015, 3)).astype(np.float32)
    return moved
