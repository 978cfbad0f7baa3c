"""The maps of neighbouring frames joined to a frame's own: what they agree on becomes steady.

Each value of the frame is carried into a neighbour by the poses. There the neighbour's map is read, and its point is
carried back. Where the two agree within the errors to expect of them, both speak of one surface that does not move, and
their mean counts; where not, the place is hidden from the neighbour, something moved, or one of the two is wrong: the
neighbour is not asked. Only values of one surface are averaged, so edges stay where the frame has them, and a frame
without a value stays without one.

What moves slowly, or as fast as the camera, agrees by and by: seen from one frame to the next its depth drifts all one
way. Where the drift is clear, and a good part of the camera's own step, neighbours are not asked either.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from priors.error_model import relative_spread
from priors.geometry import invert
from priors.machine import threads
from priors.types import Camera, Depth, FloatMap, Mask, Matrix

VERSION = 1
"""Of how moments are joined: part of the cache's key."""
USUAL_SPREAD = 0.02
"""Mean relative error to expect of a map that does not tell its own."""
SPREADS = 2.0
"""Two values agree where they differ by no more than so many of their spreads."""
AGREE = 0.3
"""The logarithm of two values of one surface never differs by more."""
ROUGH = 0.03
"""Difference from the mean, in the logarithm, at which a value counts half."""
ROUNDS = 2
DRIFT_WINDOW_PX = 9
DRIFT = 0.5
"""What drifts by more than this share of the camera's step a frame has moved."""
CLEAR = 1.0
"""Standard errors that a drift is above."""
Stack = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Moment:
    """A frame's map, and where it was seen from."""

    depth: Depth
    camera: Camera
    T_world_cam: Matrix
    """(4, 4) metres."""
    offset: int = 0
    """Frames from the one that is joined to."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """What a neighbour says of each value of a frame's map."""

    offset: int
    log_ratio: FloatMap
    """(height, width) ln of its depth over the frame's own; 0 where it does not agree."""
    weight: FloatMap
    """(height, width) 1 / spread^2; 0 where it does not agree."""
    seen: Mask
    """(height, width) whether it has a value there at all."""


def join_moments(own: Moment, others: Sequence[Moment]) -> Depth:
    """Return the frame's map, each value joined with what agrees with it in the neighbours' maps.

    The confidences are the frame's own. `consistency` is the share of the neighbours that have a value at the place and
    agree, 0 where none has one.

    Args:
        own: the frame's map.
        others: maps of its neighbours, of any size and camera.
    """
    depth_m = np.ascontiguousarray(own.depth.depth_m, np.float32)
    spread = relative_spread(own.depth, USUAL_SPREAD)
    asked = [_ask(own, depth_m, spread, other) for other in others]
    if not asked:
        return replace(own.depth, consistency=np.zeros_like(depth_m))
    still = ~_drifts(depth_m, asked, _step_m(own, others))
    ratios = np.stack([np.zeros_like(depth_m), *(each.log_ratio for each in asked)])
    weights = np.stack([np.square(1 / spread), *(each.weight * still for each in asked)])
    joined_m = depth_m * np.exp(_mean(ratios, weights))
    seen = np.sum([each.seen for each in asked], axis=0, dtype=np.float32)
    agreeing = np.count_nonzero(weights[1:], axis=0).astype(np.float32)
    consistency = np.divide(agreeing, seen, out=np.zeros_like(seen), where=seen > 0)
    return replace(own.depth, depth_m=np.where(depth_m > 0, joined_m, 0).astype(np.float32), consistency=consistency)


def _ask(own: Moment, depth_m: FloatMap, spread: FloatMap, other: Moment) -> _Asked:
    """Look a neighbour's map up at each value of the frame's."""
    from priors.kernels.reprojection import look_up

    found, place = np.empty(depth_m.shape, np.float32), np.empty(depth_m.shape, np.int32)
    other_m = np.ascontiguousarray(other.depth.depth_m, np.float32)
    work = partial(look_up, depth_m, other_m, pixel_motion(own, other), pixel_motion(other, own), found, place)
    threads.over(len(depth_m), work, threads.worth(20 * depth_m.shape[1]))
    seen = place >= 0
    its_spread = relative_spread(other.depth, USUAL_SPREAD).ravel()[np.where(seen, place, 0)]
    most = np.minimum(np.float32(SPREADS) * np.hypot(spread, its_spread), np.float32(AGREE))
    agrees = seen & (np.abs(np.where(seen, found, 0)) <= most)
    return _Asked(other.offset, np.where(agrees, found, 0), np.where(agrees, np.square(1 / its_spread), 0), seen)


def pixel_motion(one: Moment, other: Moment) -> Matrix:
    """Return what maps (x z, y z, z, 1) of a pixel (x, y) with depth z in one view to those of the other: (3, 4)."""
    T = invert(other.T_world_cam) @ one.T_world_cam
    K = other.camera.K
    return np.hstack([K @ T[:3, :3] @ np.linalg.inv(one.camera.K), K @ T[:3, 3:]])


def _step_m(own: Moment, others: Sequence[Moment]) -> float:
    """Return how far the camera goes from frame to frame, metres."""
    steps_m = [
        np.linalg.norm(other.T_world_cam[:3, 3] - own.T_world_cam[:3, 3]) / max(1, abs(other.offset))
        for other in others
    ]
    return float(np.mean(steps_m))


def _drifts(depth_m: FloatMap, asked: Sequence[_Asked], step_m: float) -> Mask:
    """Tell where the depth drifts all one way from frame to frame (height, width), against what a still scene does.

    The drift is the slope of a line through the window's ratios by the frames' offsets; its error is that of the mean
    spread, as if the errors of a window were all the same.
    """
    top, below, count, weight = (np.zeros_like(depth_m) for _ in range(4))
    for each in asked:
        agrees = (each.weight > 0).astype(np.float32)
        top += np.float32(each.offset) * each.log_ratio
        below += np.float32(each.offset**2) * agrees
        count += agrees
        weight += each.weight
    window = (DRIFT_WINDOW_PX, DRIFT_WINDOW_PX)
    top, below, count, weight = (np.asarray(cv2.blur(v, window), np.float32) for v in (top, below, count, weight))
    slope = np.abs(np.divide(top, below, out=np.zeros_like(top), where=below > 0))
    error = np.sqrt(np.divide(count, below * weight, out=np.zeros_like(top), where=(below > 0) & (weight > 0)))
    return np.asarray((slope * depth_m > DRIFT * step_m) & (slope > CLEAR * error))


def _mean(values: Stack, weights: Stack) -> FloatMap:
    """Return the weighted mean (height, width) of values (n, height, width), what lies far from it counting less.

    A few rounds of iteratively reweighted least squares with Cauchy's weights (Holland and Welsch, 1977).
    """
    mean = np.sum(values * weights, axis=0) / np.sum(weights, axis=0)
    for _ in range(ROUNDS):
        near = weights / (1 + np.square((values - mean) / np.float32(ROUGH)))
        mean = np.sum(values * near, axis=0) / np.sum(near, axis=0)
    return np.asarray(mean, np.float32)
