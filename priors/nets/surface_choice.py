"""Surface choice: on which of the surfaces around it a pixel lies, where stereo is unsure.

Beside an outline, behind glass and on thin things two surfaces match about alike, and a network says something between
them, or the far one. Where its confidence is low, a small rule looks at the disparities around: the map itself, the
nearest and the farthest value of windows of several sizes, and what is of the pixel's own colour. It answers how much
each of the windows' values counts. The result is their weighted mean, so that nothing comes out that the network saw
nowhere near. A wide rule may also choose planes continued (surface_planes.py) and the first sure pixel on each side
(sure_neighbours.py): in the middle of a hole no value around is right.

The rule is a dense network of two hidden layers. `priors train surfaces` fits it (priors/learn/surface_fit.py); the
header of the weights holds it. The classical method has a rule of its own (weights/classical.json).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.nets import sure_neighbours, surface_planes
from priors.nets.confidence import is_hidden
from priors.nets.sure_neighbours import find_sure
from priors.nets.surface_planes import continue_planes
from priors.types import FloatMap, Image, Mask

ENTRY = "surfaces"
"""Its name in the header."""
UNSURE = 0.6
"""Pixels of less confidence are looked at."""
NEAREST, FARTHEST = (3, 5, 9, 25), (5, 9)
"""Sides of the windows, pixels, whose largest and smallest disparity are offered."""
OFFERED = 1 + len(NEAREST) + len(FARTHEST)
MEANS = (9, 25)
"""Sides of the windows that the confidence is averaged over."""
BELOW = 8
"""How many rows below a pixel the rule looks too: at the ground that a thing stands on."""
HIDDEN = (16, 16)
"""Values of the hidden layers."""
SEEN_PX = ((-8, 0), (25, 0), (0, -8), (0, 8), (0, -25), (0, 25), (-25, 0))
"""Rows and columns from a pixel to those whose disparity the rule compares with its own."""
GRID = 12, 3
"""How far the neighbours lie that it compares by colour, and from one to the next, pixels."""
ALIKE_GREY = 12.0
"""Sum of three channels' differences that weakens a neighbour to 1/e."""
FIRST_CLUES = 6 + len(MEANS) + OFFERED - 1
"""What rules of before looked at: the first of the clues."""
CLUES = FIRST_CLUES + 1 + len(SEEN_PX) + 4
WIDE_OFFERED = OFFERED + len(surface_planes.REACHES) + sure_neighbours.SIDES
WIDE_CLUES = CLUES + surface_planes.CLUES_EACH * len(surface_planes.REACHES)
WIDE_CLUES += sure_neighbours.CLUES_EACH * sure_neighbours.SIDES
"""The same of a wide rule, which planes and sure neighbours come after."""
LEAST_PX, LEAST_SIGMA_PX = 1.0, 0.05
"""What a disparity and a deviation are at least, before their logarithm is taken."""
LARGEST_LOGIT = 30.0
Layers = tuple[tuple[FloatMap, FloatMap], ...]
"""Weights (inputs, outputs) and bias (outputs) of each."""
Maps = tuple[FloatMap, FloatMap, FloatMap, FloatMap]
"""Disparity and its deviation, px, doubt, and confidence in [0, 1]."""


@dataclass(frozen=True)
class SurfaceChoice:
    """A fitted rule."""

    layers: Layers
    """Of a dense network, ReLU between them: CLUES values to OFFERED logits, WIDE_CLUES to WIDE_OFFERED of a wide rule.
    Rules of before take the first clues."""

    @classmethod
    def read(cls, about: Mapping[str, Any]) -> Self | None:
        """Take the rule from the header of weights, or the classical method's file; None where there is none."""
        held = about.get(ENTRY)
        if held is None:
            return None
        return cls(tuple((np.array(weight, np.float32), np.array(bias, np.float32)) for weight, bias in held))

    def record(self) -> list[Any]:
        """Return what the header holds."""
        return [[np.round(part, 4).tolist() for part in layer] for layer in self.layers]

    def __call__(self, maps: Maps, left: Image, apart: Mask | None = None) -> FloatMap:
        """Return a left view's disparity (height, width), px, with another surface chosen where the network is unsure.

        Args:
            maps: what the network says, (height, width) each.
            left: (height, width) or (height, width, 3) uint8.
            apart: (height, width), True where the disparity stays: the sky.
        """
        disparity_px, _, _, confidence = maps
        unsure = np.flatnonzero(confidence < UNSURE if apart is None else (confidence < UNSURE) & ~apart)
        if not unsure.size:
            return disparity_px
        offered_px, clues = look(maps, left, unsure, wide=self.layers[-1][1].size == WIDE_OFFERED)
        chosen = disparity_px.copy()
        chosen.reshape(-1)[unsure] = self.decide(clues, offered_px)
        return chosen

    def decide(self, clues: FloatMap, offered_px: FloatMap) -> FloatMap:
        """Return the mean (n,) of what is offered (OFFERED, n), px, as the rule weighs it by clues (CLUES, n).

        A wide rule has more rows of both.
        """
        from priors.kernels.dense import dense

        values = dense(np.ascontiguousarray(clues[: len(self.layers[0][0])], np.float32), self.layers)
        share = np.exp(np.clip(values - values.max(axis=0), -LARGEST_LOGIT, 0))
        return np.asarray((share * offered_px).sum(axis=0) / share.sum(axis=0), np.float32)


def look(maps: Maps, left: Image, at: npt.NDArray[np.intp], *, wide: bool = False) -> tuple[FloatMap, FloatMap]:
    """Return the disparities that pixels choose from, (OFFERED, n) px, and the rule's clues (CLUES, n).

    Args:
        maps: what the network says, (height, width) each.
        left: (height, width) or (height, width, 3) uint8.
        at: (n,) indices of pixels, rising.
        wide: offer what lies farther away too: (WIDE_OFFERED, n) and (WIDE_CLUES, n).
    """
    offered_px = offer(maps[0], at)
    clues = see(offered_px, maps, left, at)
    if not wide:
        return offered_px, clues
    planes_px, of_planes = continue_planes(maps[0], maps[3], at)
    sure_px, of_sure = find_sure(maps[0], maps[3] >= UNSURE, at)
    return np.concatenate([offered_px, planes_px, sure_px]), np.concatenate([clues, of_planes, of_sure])


def offer(disparity_px: FloatMap, at: npt.NDArray[np.intp]) -> FloatMap:
    """Return the disparities to choose from (OFFERED, n), px: the map's own, the largest and the smallest around.

    Args:
        disparity_px: (height, width).
        at: (n,) indices of pixels.
    """
    found = [disparity_px.reshape(-1)[at]]
    for sides, extreme in ((NEAREST, cv2.dilate), (FARTHEST, cv2.erode)):
        map_, reached = disparity_px, 1
        for side in sides:  # a window of a window: the larger one costs only what it is larger by
            step = side - reached + 1
            map_, reached = np.asarray(extreme(map_, np.ones((step, step), np.uint8)), np.float32), side
            found.append(map_.reshape(-1)[at])
    return np.stack(found)


def see(offered_px: FloatMap, maps: Maps, left: Image, at: npt.NDArray[np.intp]) -> FloatMap:
    """Return what the rule looks at (CLUES, n).

    Args:
        offered_px: (OFFERED, n) of `offer`.
        maps: what the network says, (height, width) each.
        left: (height, width) or (height, width, 3) uint8.
        at: (n,) indices of pixels.
    """
    disparity_px, sigma_px, doubt, confidence = maps
    height, width = disparity_px.shape
    logs = np.log(np.maximum(offered_px, np.float32(LEAST_PX)))
    map_log = np.log(np.maximum(disparity_px, np.float32(LEAST_PX)))
    row, column = at // width, at % width

    def beside(rows: int, columns: int) -> FloatMap:
        there = map_log[np.clip(row + rows, 0, height - 1), np.clip(column + columns, 0, width - 1)]
        return np.asarray(there - logs[0], np.float32)

    trusted = [cv2.blur(confidence, (side, side)).reshape(-1)[at] for side in MEANS]
    return np.concatenate(
        [
            np.stack(
                [
                    confidence.reshape(-1)[at],
                    logs[0],
                    np.log(sigma_px.reshape(-1)[at] + np.float32(LEAST_SIGMA_PX)),
                    doubt.reshape(-1)[at],
                    *trusted,
                    is_hidden(disparity_px).reshape(-1)[at].astype(np.float32),
                    beside(BELOW, 0),
                    *(logs[1:] - logs[0]),
                    row.astype(np.float32) / np.float32(height),
                    *(beside(*step) for step in SEEN_PX),
                ]
            ),
            look_around(map_log, confidence, left, at),
        ]
    ).astype(np.float32, copy=False)


def look_around(map_log: FloatMap, confidence: FloatMap, left: Image, at: npt.NDArray[np.intp]) -> FloatMap:
    """Return what the neighbours say (4, n), those of the pixel's colour and all: see kernels/surroundings.py."""
    from priors.kernels.surroundings import gather

    image, trust = np.ascontiguousarray(as_rgb(left)), np.ascontiguousarray(confidence, np.float32)
    alike = np.exp(-np.arange(3 * 255 + 1) / ALIKE_GREY).astype(np.float32)
    found = np.empty((4, at.size), np.float32)
    gather(image, map_log, trust, at, GRID, alike, found)
    return found
