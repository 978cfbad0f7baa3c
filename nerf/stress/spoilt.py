"""Spoilt scenes: what is wrong with the inputs of fits under stress. Each is a right scene with one fault."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nerf.scene import Scene

Floats = npt.NDArray[np.float32]
SHARE, SQUARE, FACTOR = 0.3, 20 / 187, 10.0
"""Which share of a prior is wrong, in squares how large, as a share of the height, and how many times too far. On KITTI
at half size, on which the check before a fit was chosen, a square has 20 px."""


def scaled(factor: float) -> Callable[[Scene], Scene]:
    """Return what gives a prior another scale."""
    return lambda scene: with_depth(scene, np.float32(factor) * depths(scene))


def at_random(scene: Scene, factor: float = FACTOR) -> Scene:
    """Make SHARE of the prior's values wrong, each by itself."""
    depth_m = depths(scene)
    wrong = np.random.default_rng(0).random(depth_m.shape) < SHARE
    return with_depth(scene, np.where(wrong, np.float32(factor) * depth_m, depth_m))


def in_blobs(scene: Scene, factor: float = FACTOR) -> Scene:
    """Make SHARE of the prior's values wrong in each frame, in squares."""
    depth_m = depths(scene)
    side_px = max(1, round(SQUARE * depth_m.shape[1]))
    random, wrong = np.random.default_rng(0), np.zeros(depth_m.shape, bool)
    for frame in wrong:
        while frame.mean() < SHARE:
            row, column = (int(random.integers(1 - side_px, size)) for size in frame.shape)
            frame[max(row, 0) : row + side_px, max(column, 0) : column + side_px] = True
    return with_depth(scene, np.where(wrong, np.float32(factor) * depth_m, depth_m))


def with_a_black_frame(scene: Scene) -> Scene:
    """Make the training frame in the middle black, as a camera that missed it gives it."""
    images = np.stack([np.asarray(scene.images[position]) for position in range(len(scene.ids))])
    images[_middle(scene)] = 0
    return replace(scene, images=images)


def without_a_frame(scene: Scene) -> Scene:
    """Leave that training frame out: what a fit with a black one should come to."""
    return replace(scene, train=[position for position in scene.train if position != _middle(scene)])


def _middle(scene: Scene) -> int:
    return scene.train[len(scene.train) // 2]


def depths(scene: Scene) -> Floats:
    """Return the prior's maps of all frames (frames, height, width), metres; the scene has one."""
    assert scene.depth_m is not None
    return np.stack([np.asarray(scene.depth_m[position]) for position in range(len(scene.ids))])


def with_depth(scene: Scene, depth_m: Floats) -> Scene:
    """Return the scene with other maps of its prior."""
    return replace(scene, depth_m=depth_m)
