"""What completion learns from: a scene's image, all its LiDAR points, and which of them the network is shown.

Two kinds of scene: the procedural street, whose truth is dense and exact, and a real drive, whose truth is what several
sweeps saw, accumulated and cleaned as the official truth of KITTI is.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.errors import DataError
from priors.learn import sample as samples
from priors.methods.lidar import hidden
from priors.street import rig
from priors.types import Camera, FloatMap, Image, Mask, Matrix

Points = npt.NDArray[np.float32]
FARTHEST_M = 90.0
"""Truth beyond this teaches nothing: no LiDAR sample is ever there."""
COVERED_PX = (15, 9)
"""Rows and columns around LiDAR samples for which official truth has values: 11 sweeps fill the gaps of one."""
ASIDE = 0.05
"""Weight of the truth elsewhere: a scanner does not see it, but users do."""
RAGGED, AT_EDGES = 1.1, 0.35
"""Weight of truth whose 5x5 pixels differ by more than a ratio: leaves, outlines; official truth has fewer of them."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One moment: image, LiDAR points, and the truth where it is known beside them."""

    image: Image
    """(h, w, 3) uint8."""
    camera: Camera
    T_cam_lidar: Matrix
    points_m: Points
    """(n, 3) in the camera's axes, inside the image."""
    beam: npt.NDArray[np.uint8]
    """(n,) scan line, 0 = the highest."""
    truth_m: FloatMap
    """(h, w) 0 = unknown."""
    real: bool
    """Truth is accumulated LiDAR, sparse and with what its cleaning left over."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A scene with some of its points shown, and the truth to judge by."""

    scene: Scene
    sparse_m: FloatMap
    truth_m: FloatMap
    weight: FloatMap
    """(h, w) in [0, 1], 0 where there is no truth."""


class Streets:
    """Rendered samples: every tenth world is for validation."""

    def __init__(self, folder: Path) -> None:
        numbers = sorted(path for path in folder.glob("*.npz") if path.stem.isdigit())
        held = [int(path.stem) // samples.PER_WORLD % 10 == 3 for path in numbers]
        self.train = [path for path, out in zip(numbers, held, strict=True) if not out]
        self.validation = [path for path, out in zip(numbers, held, strict=True) if out]
        if not self.train:
            raise DataError(f"{folder}: no samples to train on: render them with priors train samples")

    @staticmethod
    def read(path: Path) -> Scene:
        """Read a sample."""
        found = samples.read(path)
        truth_m = np.where(found.depth_m < FARTHEST_M, found.depth_m, np.float32(0))
        return Scene(found.left, found.camera, rig.T_left_velo(), found.points_m, found.beam, truth_m, real=False)


def show(scene: Scene, rng: np.random.Generator, every: int | None = None) -> Shown:
    """Choose which points are shown: each `every`-th scan line; None: also random points, fewer of them, or holes."""
    kept = scene.beam % every == 0 if every else _choose(scene.points_m, scene.beam, rng, scene.real)
    points_m = scene.points_m
    if not scene.real and not every and rng.random() < 0.5:
        points_m = _misplace(points_m, rng)
    sparse_m = splat(points_m[kept], scene.camera)
    every_m = splat(scene.points_m, scene.camera)
    if scene.real:
        every_m[hidden(np.where(every_m > 0, every_m, np.float32(np.inf)), scene.camera.fx)] = 0
        unseen_m = np.where(sparse_m > 0, np.float32(0), every_m)
        truth_m = np.where(unseen_m > 0, unseen_m, scene.truth_m)
        return Shown(scene, sparse_m, truth_m, (truth_m > 0).astype(np.float32))
    around = np.ones((2 * COVERED_PX[0] + 1, 2 * COVERED_PX[1] + 1), np.uint8)
    covered = cv2.dilate((every_m > 0).astype(np.uint8), around) > 0
    weight = np.where(covered, np.float32(1), np.float32(ASIDE)) * (scene.truth_m > 0)
    weight[_ragged(scene.truth_m)] *= AT_EDGES
    return Shown(scene, sparse_m, scene.truth_m, weight.astype(np.float32))


def crop(scene: Scene, top: int, left: int, size: tuple[int, int]) -> Scene:
    """Cut a window out of a scene."""
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    camera = geometry.crop(scene.camera, top, left, size)
    inside = pixels(scene.points_m, camera)[1]
    return replace(
        scene,
        image=scene.image[rows, columns],
        camera=camera,
        points_m=scene.points_m[inside],
        beam=scene.beam[inside],
        truth_m=scene.truth_m[rows, columns],
    )


def flip(scene: Scene) -> Scene:
    """Mirror a scene."""
    K, T = scene.camera.K.copy(), scene.T_cam_lidar.copy()
    K[0, 2] = scene.camera.size[1] - 1 - K[0, 2]
    T[0, 3] *= -1  # only where the scanner stands is ever looked at
    return replace(
        scene,
        image=np.ascontiguousarray(scene.image[:, ::-1]),
        camera=Camera(K, scene.camera.size),
        T_cam_lidar=T,
        points_m=scene.points_m * np.array([-1, 1, 1], np.float32),
        truth_m=np.ascontiguousarray(scene.truth_m[:, ::-1]),
    )


def rescale(scene: Scene, factor: float) -> Scene:
    """Make everything larger; the image stays as it is."""
    T = scene.T_cam_lidar.copy()
    T[:3, 3] *= factor
    size = np.float32(factor)
    return replace(scene, T_cam_lidar=T, points_m=scene.points_m * size, truth_m=scene.truth_m * size)


def pixels(points_m: Points, camera: Camera) -> tuple[npt.NDArray[np.intp], Mask]:
    """Return columns and rows (n, 2) of the points, and which lie inside the image."""
    z = np.maximum(points_m[:, 2:], np.float32(1e-3))
    uv = np.rint(points_m[:, :2] / z * [camera.K[0, 0], camera.K[1, 1]] + camera.K[:2, 2]).astype(np.intp)
    height, width = camera.size
    return uv, (points_m[:, 2] > 0.1) & np.all((uv >= 0) & (uv < [width, height]), axis=1)


def splat(points_m: Points, camera: Camera) -> FloatMap:
    """Return the sparse map (h, w) of points (n, 3), metres; where two fall on one pixel, the nearer."""
    uv, inside = pixels(points_m, camera)
    uv, z = uv[inside], points_m[inside, 2]
    order = np.argsort(-z, kind="stable")
    sparse_m = np.zeros(camera.size, np.float32)
    sparse_m[uv[order, 1], uv[order, 0]] = z[order]
    return sparse_m


def _ragged(truth_m: FloatMap) -> Mask:
    """Tell where surfaces of different depth meet (h, w)."""
    window = np.ones((5, 5), np.uint8)
    nearest = cv2.erode(np.where(truth_m > 0, truth_m, np.float32(FARTHEST_M)), window)
    return cv2.dilate(truth_m, window) > RAGGED * nearest


def _choose(points_m: Points, beam: npt.NDArray[np.uint8], rng: np.random.Generator, real: bool) -> Mask:
    """Tell which points are shown (n,)."""
    count = len(points_m)
    if rng.random() < 0.12:
        wanted = np.exp(rng.uniform(np.log(30), np.log(3000)))
        return rng.random(count) < wanted / max(count, 1)
    every = int(rng.choice([1, 2, 4, 8], p=[0.6, 0.2, 0.12, 0.08]))
    kept = beam % every == rng.integers(every)
    if rng.random() < 0.3:
        kept &= rng.random(count) < rng.uniform(0.3, 1)
    if real and rng.random() < 0.4:
        kept &= ~_gaps(points_m, beam, rng)
    elif rng.random() < 0.3:
        kept &= ~_holes(points_m, rng)
    return kept


def _gaps(points_m: Points, beam: npt.NDArray[np.uint8], rng: np.random.Generator) -> Mask:
    """Tell which points lie on pieces of scan lines that are left out, as truth between two shown lines."""
    sector = np.floor(np.arctan2(points_m[:, 0], points_m[:, 2]) / 0.12 + rng.random()).astype(np.intp)
    out = rng.random((64, sector.max(initial=0) - sector.min(initial=0) + 1)) < 0.25
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
