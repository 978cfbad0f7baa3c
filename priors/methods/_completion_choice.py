"""Depth choice: which depth a pixel gets where the completion network is unsure of its own.

Beside an outline the network says something between two surfaces, and where it doubts a point that was seen past an
edge it sometimes doubts a true one. Where it is unsure, a small rule weighs six depths: the network's, the fill's, that
of the nearest sample, of the nearest and of the farthest surface that samples around show, and the network's moved by
what it misses the samples beside by. The pixel goes most of the way to their weighted mean, in the logarithm. The rule
looks at ratios of depths only, so twice the depths in give twice the depths out.

`priors train choice` fits it (priors/learn/choice_fit.py); the header of the weights holds it. It is evaluated as
stereo's choice of surfaces is (priors/nets/surface_choice.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.nets import surface_choice
from priors.nets.surface_choice import SurfaceChoice
from priors.types import FloatMap, Mask

ENTRY = "choice"
"""Its name in the header."""
UNSURE = 0.011
"""Pixels whose expected error is a larger share of the depth are looked at: about a third of a KITTI image."""
APART = 0.01
"""So are those where network and fill differ by a larger share."""
SAY = 0.7
"""How much of the way from the network's depth to the rule's a pixel goes, in the logarithm. All of the way has the
lowest mean error, but a higher RMSE than the network alone has."""
AROUND = (11, 7)
"""Rows and columns of the window whose nearest and farthest sample are offered."""
BESIDE = 5
"""Side of the window that tells by how much the network misses the samples, pixels."""
MISSES = 0.05
"""A sample that it misses by more, as a share of the depth, is of another surface and tells nothing."""
NEAR, WIDE, WIDEST = 9, 13, 41
"""Sides of the windows that are averaged over, pixels."""
FARTHEST_PX = 12.0
"""Distances to a sample beyond this are alike."""
NOTHING = np.float32(1e3)
"""Logarithms of this size or more are of no sample."""
OFFERED, CLUES = 6, 19
Maps = tuple[FloatMap, FloatMap, FloatMap, FloatMap, FloatMap]
"""The network's depth and the fill's, metres, > 0; the samples, metres, 0 = none, at least one; the expected error as a
share of the depth; and the fill's certainty in [0, 1]: (height, width) each."""


class Pixels(NamedTuple):
    """Pixels that the rule is asked for, n of them."""

    at: npt.NDArray[np.intp]
    """(n,) their indices."""
    offered: FloatMap
    """(OFFERED, n) logarithms of the depths to choose from, the network's first."""
    clues: FloatMap
    """(CLUES, n) what the rule looks at."""


@dataclass(frozen=True)
class DepthChoice:
    """A fitted rule."""

    rule: SurfaceChoice
    """What weighs OFFERED values by CLUES."""

    @classmethod
    def read(cls, about: Mapping[str, Any]) -> Self | None:
        """Take the rule from the header of weights; None where there is none."""
        rule = SurfaceChoice.read({surface_choice.ENTRY: about.get(ENTRY)})
        return None if rule is None else cls(rule)

    def record(self) -> list[Any]:
        """Return what the header holds."""
        return self.rule.record()

    def __call__(self, maps: Maps, near: Mask) -> FloatMap:
        """Return depth (height, width), metres, chosen anew where the network is unsure and a value is wanted."""
        pixels = see(maps, find_unsure(maps, near))
        chosen_m = maps[0].copy()
        if pixels.at.size:
            chosen_m.reshape(-1)[pixels.at] = np.exp(self.decide(pixels.clues, pixels.offered))
        return chosen_m

    def decide(self, clues: FloatMap, offered: FloatMap) -> FloatMap:
        """Return the logarithms of the depths (n,) that pixels get: see Pixels."""
        return offered[0] + np.float32(SAY) * (self.rule.decide(clues, offered) - offered[0])


def find_unsure(maps: Maps, near: Mask) -> npt.NDArray[np.intp]:
    """Return the indices (n,) of the pixels, among those near a sample (height, width), that the rule is asked for."""
    net_m, fill_m, _, error, _ = maps
    return np.flatnonzero(near & ((error > UNSURE) | (np.abs(net_m - fill_m) > APART * fill_m)))


def see(maps: Maps, at: npt.NDArray[np.intp]) -> Pixels:
    """Return what is offered at pixels (n,), and what tells which of it is right."""
    net_m, fill_m, sparse_m, error, certain = maps
    known = sparse_m > 0
    log_net, log_fill = np.log(net_m), np.log(fill_m)
    log_sample = np.log(np.where(known, sparse_m, np.float32(1)))
    distance_px, nearest = _nearest_sample(log_sample, known)
    low, high = _extremes(log_sample, known)
    missed = np.where(known, log_sample - log_net, np.float32(0))
    missed_fill = np.where(known, log_sample - log_fill, np.float32(0))

    def pick(map_: FloatMap) -> FloatMap:
        return np.asarray(map_.reshape(-1)[at], np.float32)

    net, fill, change = pick(log_net), pick(log_fill), log_net - log_fill
    nearest_at = pick(nearest)
    below, above = pick(low), pick(high)
    below, above = (np.where(np.abs(value) < NOTHING, value, net) for value in (below, above))
    share = _mean(known.astype(np.float32), WIDE)
    offered = np.stack([net, fill, nearest_at, below, above, net + pick(_correction(missed, known))])
    clues = [
        _size(net - fill),
        _sign(net - fill),
        np.log(pick(error)),
        pick(certain),
        np.minimum(pick(distance_px), np.float32(FARTHEST_PX)) / 4,
        _size(pick(_spread(log_fill))),
        _size(pick(_spread(log_net))),
        _size(pick(_mean_miss(missed, share))),
        _size(pick(_mean_miss(missed_fill, share))),
        _sign(pick(_mean(change, NEAR))),
        _size(pick(_mean(np.abs(change), NEAR))),
        fill - np.float32(log_fill.mean()),
        _sign(net - nearest_at),
        _sign(fill - nearest_at),
        _sign(below - net),
        _sign(above - net),
        _size(above - below),
        np.log(pick(_mean(known.astype(np.float32), WIDEST)) + np.float32(1e-3)),
        _sign(offered[5] - net),
    ]
    return Pixels(at, offered, np.stack(clues).astype(np.float32, copy=False))


def _size(ratio: FloatMap) -> FloatMap:
    """Return how large a logarithm of a ratio is, on a scale that tells small ones apart."""
    return np.log(np.abs(ratio) + np.float32(0.002))


def _sign(ratio: FloatMap) -> FloatMap:
    """Return a logarithm of a ratio, large ones alike."""
    return np.tanh(np.float32(8) * ratio)


def _nearest_sample(log_sample: FloatMap, known: Mask) -> tuple[FloatMap, FloatMap]:
    """Return the distance to each pixel's nearest sample, pixels, and that one's value (height, width)."""
    distance_px, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    values = np.zeros(int(label.max()) + 1, np.float32)
    values[label[known]] = log_sample[known]
    return np.asarray(distance_px, np.float32), values[label]


def _extremes(log_sample: FloatMap, known: Mask) -> tuple[FloatMap, FloatMap]:
    """Return the nearest and the farthest sample of the window around each pixel (height, width); NOTHING: none."""
    window = np.ones(AROUND, np.uint8)
    low = cv2.erode(np.where(known, log_sample, NOTHING), window)
    high = cv2.dilate(np.where(known, log_sample, -NOTHING), window)
    return np.asarray(low, np.float32), np.asarray(high, np.float32)


def _correction(missed: FloatMap, known: Mask) -> FloatMap:
    """Return by how much the samples beside, and one that is no sample, say that the network is off (height, width)."""
    tells = known & (np.abs(missed) < MISSES)
    total = _mean(np.where(tells, missed, np.float32(0)), BESIDE)
    return np.asarray(total / (_mean(tells.astype(np.float32), BESIDE) + 1 / BESIDE**2), np.float32)


def _mean_miss(missed: FloatMap, share: FloatMap) -> FloatMap:
    """Return by how much the samples around are missed on average (height, width)."""
    size = np.minimum(np.abs(missed), np.float32(0.3))
    return np.asarray(_mean(size, WIDE) / (share + np.float32(1e-3)), np.float32)


def _mean(map_: FloatMap, side: int) -> FloatMap:
    """Return the mean of a window of so many pixels around each (height, width)."""
    return np.asarray(cv2.blur(map_, (side, side)), np.float32)


def _spread(log_depth: FloatMap) -> FloatMap:
    """Return how far apart the depths of 5x5 pixels are (height, width)."""
    window = np.ones((5, 5), np.uint8)
    return np.asarray(cv2.dilate(log_depth, window) - cv2.erode(log_depth, window), np.float32)
