"""Votes between posed depth maps, compiled: nerf/evidence/votes.py says what they are about.

Inverse depths (1/m), matrices (3, 4) between views and `land` are those of warp_draw.py.
"""

from typing import NamedTuple

from nerf.kernels.cpu.warp_draw import NONE, Floats, Matrices, land
from priors.machine.compiled import compiled

STRIDE = 3
"""Of a window's pixels, every third along each axis is asked."""


class Voter(NamedTuple):
    """Another frame, whose values vote."""

    inverse: Floats
    """(h, w) inverse depth, 1/m; NONE where there is none."""
    trust: Floats
    """(h, w) how much each value's vote counts, [0, 1]."""
    here: Matrices
    """(3, 4) from its pixels to those of the frame that is voted on."""
    there: Matrices
    """(3, 4) the other way."""


class Rules(NamedTuple):
    """How votes are cast."""

    agree: float
    """Values agree where the farther is at most so many times as far as the nearer."""
    against: float
    """They contradict each other where it is more than so many times as far; in between they say nothing."""
    hidden: float
    """How much it counts against a value that another one hides it."""
    hides: float
    """How much it counts against a value that it hides another one."""
    layer: float
    """Values share their votes where the farther is at most so many times as far as the nearer."""
    half_px: int
    """How far away they may be, pixels."""


@compiled(error_model="numpy")
def vote(inverse: Floats, voter: Voter, rules: Rules, ballot: Floats) -> None:
    """Add another frame's votes on the values of one frame.

    Args:
        inverse: (h, w) the values, inverse depth in 1/m; NONE where there is none.
        voter: the other frame.
        rules: how votes are cast.
        ballot: (2, h, w) the votes that agree and those against, filled in place.
    """
    h, w = inverse.shape
    for row in range(h):
        for column in range(w):
            if inverse[row, column] > 0:  # what this frame's value says where the other frame sees it
                u, v, expected = land(voter.there, float(column), float(row), float(inverse[row, column]))
                x, y, found = _nearest(voter.inverse, u, v, expected)
                if found > 0:
                    weight = voter.trust[y, x]
                    if _alike(found, expected, rules.agree):
                        ballot[0, row, column] += weight
                    elif not _alike(found, expected, rules.against):
                        ballot[1, row, column] += weight * (rules.hidden if found > expected else 1.0)
            if voter.inverse[row, column] > 0:  # what the other frame's value says where this frame sees it
                u, v, expected = land(voter.here, float(column), float(row), float(voter.inverse[row, column]))
                x, y, found = _nearest(inverse, u, v, expected)
                if found > 0:
                    if _alike(found, expected, rules.agree):
                        ballot[0, y, x] += voter.trust[row, column]
                    elif not _alike(found, expected, rules.against):
                        ballot[1, y, x] += voter.trust[row, column] * (rules.hides if found > expected else 1.0)


@compiled(error_model="numpy")
def pool(inverse: Floats, ballot: Floats, rules: Rules, first: int, last: int, out: Floats) -> None:
    """Let values share the votes of those around them that are about as far, rows first to last - 1.

    Args:
        inverse: (h, w) the values, 1/m.
        ballot: (2, h, w) the votes on them.
        rules: how far away the others may be, and how much farther.
        first: row.
        last: row.
        out: (2, h, w) the shared votes, set in place.
    """
    h, w = inverse.shape
    for row in range(first, last):
        for column in range(w):
            agreed, against = 0.0, 0.0
            for y in range(row - rules.half_px, row + rules.half_px + 1, STRIDE):
                for x in range(column - rules.half_px, column + rules.half_px + 1, STRIDE):
                    if y < 0 or x < 0 or y >= h or x >= w:
                        continue
                    if _alike(inverse[y, x], inverse[row, column], rules.layer):
                        agreed += ballot[0, y, x]
                        against += ballot[1, y, x]
            out[0, row, column], out[1, row, column] = agreed, against


@compiled(error_model="numpy", inline="always")
def _alike(a, b, ratio):  # type: ignore[no-untyped-def]
    """Tell whether two inverse depths are about the same; never where one is none."""
    return a > 0 and b > 0 and a <= ratio * b and b <= ratio * a


@compiled(error_model="numpy", inline="always")
def _nearest(inverse, u, v, expected):  # type: ignore[no-untyped-def]
    """Return the pixel nearest to a place, column first, and its inverse depth; NONE outside and behind the camera."""
    h, w = inverse.shape
    if not (expected > 0 and u > -0.5 and v > -0.5 and u < w - 0.5 and v < h - 0.5):
        return 0, 0, float(NONE)
    x, y = int(u + 0.5), int(v + 0.5)
    return x, y, float(inverse[y, x])
