"""A corner: the centre line of a street that turns by 90 degrees, and the houses that close the view around it.

The street runs along x, turns on a quarter of a circle, and runs on along y: to the left (y > 0) or to the right. On
the inner side a square keeps clear what the two legs would build twice.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.mesh import Mesh
from priors.street.path import BEHIND_M, Path

Values = npt.NDArray[np.floating]
RADIUS_M = 12.0
"""Of the centre line: above the widest side of a street, so that nothing at the pavement folds."""
BEGIN_M = 4.0
"""Where the turn begins, metres along the street."""
SPEED_MPS = 6.5
"""A car's speed around it: 3.5 m/s2 to the side, and a turn in the usual 40 frames at 10 Hz."""
CLEAR_M = 28.0
"""From the turn on the inner side no house stands: those of the two legs are as deep."""
HOUSES = 3
"""Around the outer side."""
END_M = BEGIN_M + RADIUS_M * np.pi / 2
"""Where the turn ends."""


def with_corner(config: StreetConfig, turn: int) -> StreetConfig:
    """Return a level street that is straight but for a corner to the left (1) or to the right (-1), driven slowly."""
    speed_mps = min(config.speed_mps, SPEED_MPS)
    return replace(config, turn=turn, bend_rad=0.0, slope=0.0, speed_mps=speed_mps)


class CornerPath(Path):
    """The centre line of such a street."""

    def __init__(self, config: StreetConfig) -> None:
        self._turn = config.turn
        super().__init__(config)

    def _headings(self, config: StreetConfig, phase: Values) -> Values:
        return self._turn * np.clip((self._s - BEGIN_M) / RADIUS_M, 0, np.pi / 2)

    def grid(self, s_m: Values, t_m: Values) -> tuple[Values, Values, Values]:
        """Return x and y (t, s) of places beside the centre line, and its z."""
        s, t = np.meshgrid(s_m, t_m)
        x, y, z = np.moveaxis(self.bend(np.stack([s, t, np.zeros_like(s)], axis=-1)), -1, 0)
        return x, y, z[0]

    def locate(self, x_m: Values, y_m: Values) -> tuple[Values, Values, Values]:
        """Return s and t of places (n,), by the leg or the arc whose centre line is nearest, and z of the line."""
        x, y = np.asarray(x_m) - BEGIN_M, self._turn * np.asarray(y_m)  # as if it turned to the left
        beyond, up = np.maximum(x, 0), np.minimum(y - RADIUS_M, 0)
        angle = np.clip(np.arctan2(beyond, -up), 0, np.pi / 2)
        s = np.stack([BEGIN_M + x, BEGIN_M + RADIUS_M * angle, END_M + y - RADIUS_M])
        t = np.stack([y, RADIUS_M - np.hypot(x, y - RADIUS_M), RADIUS_M - x])
        fits = np.stack([x <= 0, (x > 0) & (y < RADIUS_M), y >= RADIUS_M])
        nearest = np.argmin(np.where(fits, np.abs(t), np.inf), axis=0)[None]
        s, t = (np.take_along_axis(each, nearest, axis=0)[0] for each in (s, t))
        return s, self._turn * t, np.zeros_like(s)

    def turned(self, part: Mesh, s_m: float) -> Mesh:
        """Place a part built in street coordinates by the frame at s alone: it turns, and is not bent."""
        T = self.pose(np.array([s_m]), np.zeros(1))[0].astype(np.float32)
        corners = (part.corners - np.array([s_m, 0, 0], np.float32)) @ T[:3, :3].T + T[:3, 3]
        return replace(part, corners=corners, normal=part.normal @ T[:3, :3].T)

    def is_clear(self, low: npt.ArrayLike, high: npt.ArrayLike, reach_m: float) -> bool:
        """Tell whether a box between two corners (3,) keeps a distance from the centre line."""
        x, y, _ = self.centre(np.arange(-BEHIND_M, self._s[-1], 5.0))
        (x0, y0, _), (x1, y1, _) = np.sort([low, high], axis=0)
        off = np.hypot(np.maximum(0, np.maximum(x0 - x, x - x1)), np.maximum(0, np.maximum(y0 - y, y - y1)))
        return bool(off.min() > reach_m)


@dataclass(frozen=True)
class Stretch:
    """A part of one side of a street that blocks are built along."""

    start_m: float
    end_m: float
    is_cut: bool = False
    """Whether the last block ends just there; else it may reach beyond."""
    is_square: bool = False
    """Whether no house may stand there."""

    def length_m(self, start_m: float, drawn_m: float, gap_m: float) -> float:
        """Return the length of a block that begins at start_m: as drawn, or as far as the stretch reaches."""
        left_m = self.end_m - start_m
        return left_m if self.is_cut and left_m < drawn_m + 2 * gap_m else drawn_m


def road_parts(config: StreetConfig, start_m: float, end_m: float) -> list[tuple[float, float]]:
    """Return the ends of the road's parts: around a corner it is cut where kerbs and pavements are, without cracks."""
    cuts = [start_m, *([BEGIN_M, float(END_M)] if config.turn else []), end_m]
    return list(pairwise(cuts))


def stretches(config: StreetConfig, side: int) -> list[Stretch]:
    """Return along what a side is built: all of it, or what a corner leaves; side is 1 = left, -1 = right."""
    if not config.turn:
        return [Stretch(-BEHIND_M, config.length_m)]
    if side != config.turn:
        return [Stretch(-BEHIND_M, BEGIN_M, is_cut=True), Stretch(END_M, config.length_m)]
    return [
        Stretch(-BEHIND_M, BEGIN_M - CLEAR_M, is_cut=True),
        Stretch(BEGIN_M - CLEAR_M, BEGIN_M, is_cut=True, is_square=True),
        Stretch(END_M, END_M + CLEAR_M, is_cut=True, is_square=True),
        Stretch(END_M + CLEAR_M, config.length_m),
    ]
