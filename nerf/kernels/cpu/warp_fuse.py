"""Fusing warped views, compiled: how far off each pixel's surface is, and which colour the views that see it have.

A pixel at a time. Each view that drew something there (warp_draw.py) offers an inverse depth. All views vote on every
offer: one whose own depth agrees votes for it, one that sees through the place votes against it, one whose view is
blocked says nothing. The offer with the most votes is refined by those that agree with it; then colours are taken from
the views whose own depth agrees, and blended by how alike they see the place.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.warp_draw import NONE, Floats, Matrices, land
from priors.machine.compiled import compiled

SMALL = 1e-3
"""Least share of trust and feather: a pixel at a border still counts where nobody else sees the place."""
LEAST_INVERSE = 1e-4
"""1/m: nearer differences than this are none."""


class Views(NamedTuple):
    """The n views that are warped."""

    images: npt.NDArray[np.uint8]
    """(n, h, w, 3)"""
    inverse: Floats
    """(n, h, w) inverse depth, 1/m; NONE where there is none."""
    trust: Floats
    """(n, h, w) how much a pixel's depth counts, [0, 1]."""
    there: Matrices
    """(n, 3, 4) from the pixel that is asked for to each view."""


class Rules(NamedTuple):
    """How depths are compared and colours blended."""

    agree_px: float
    """Depths agree where a view's colour is looked up at most so many of its pixels elsewhere ..."""
    agree_share: float
    """... and the inverse depths differ by at most this share."""
    parallax_px: float
    """Parallax that makes two views of a place unlike by 1, pixels."""
    shrinking: float
    """How unlike a view is that sees the place smaller by a factor e."""
    softness: float
    """Views unlike by so much more than the best one count 1/e of it."""
    own_vote: float
    """How much more a view's vote on its own offer counts."""
    feather_px: float
    """A view fades over so many pixels at its border."""


class Fused(NamedTuple):
    """What comes out, filled in place."""

    rgb: Floats
    """(height, width, 3) in [0, 255]; 0 where no view shows the place."""
    inverse: Floats
    """(height, width) 1/m; NONE where no view offers a depth."""
    shown: npt.NDArray[np.bool_]
    """(height, width) whether a view has a colour of it."""


@compiled(error_model="numpy")
def fuse(seen: Floats, views: Views, rules: Rules, first: int, last: int, out: Fused) -> None:
    """Fuse rows first to last - 1.

    Args:
        seen: (n, height, width) inverse depths that each view drew, 1/m; NONE where it shows nothing.
        views: n of them.
        rules: how they are compared and blended.
        first: row.
        last: row.
        out: what comes out.
    """
    n, _, width = seen.shape
    cost, offers = np.empty(n), np.empty(n)
    for row in range(first, last):
        for column in range(width):
            for i in range(n):
                offers[i] = seen[i, row, column]
            inverse = _elect(offers, views, rules, float(column), float(row), cost)
            if inverse >= 0:
                out.inverse[row, column] = inverse
                out.shown[row, column] = _blend(
                    inverse, views, rules, float(column), float(row), cost, out.rgb[row, column]
                )


@compiled(error_model="numpy")
def _elect(offers, views, rules, x, y, cost):  # type: ignore[no-untyped-def]
    """Return the inverse depth that the views agree on most; NONE where there is no offer."""
    least = np.inf
    for i in range(len(offers)):
        cost[i] = unlikeness(views.there[i], rules, x, y, offers[i]) if offers[i] >= 0 else np.inf
        least = min(least, cost[i])
    best, most = -1.0, -np.inf
    for i in range(len(offers)):
        if offers[i] < 0:
            continue
        votes = _votes(i, offers[i], views, rules, x, y, np.exp(-(cost[i] - least) / rules.softness))
        if votes > most + 1e-6 or (votes > most - 1e-6 and offers[i] > best):
            best, most = offers[i], votes
    if best < 0:
        return best
    total, weight = 0.0, 0.0
    for i in range(len(offers)):
        if offers[i] >= 0 and abs(offers[i] - best) <= rules.agree_share * best + LEAST_INVERSE:
            share = np.exp(-(cost[i] - least) / rules.softness) + 1e-9
            total, weight = total + share * offers[i], weight + share
    return total / weight


@compiled(error_model="numpy")
def _votes(i, inverse, views, rules, x, y, likeness):  # type: ignore[no-untyped-def]
    """Count the votes for view i's offer of an inverse depth."""
    votes = rules.own_vote * likeness
    for j in range(len(views.inverse)):
        u, v, expected = land(views.there[j], x, y, inverse)
        found = _look(views.inverse[j], u, v) if expected >= 0 else -1.0
        if found < 0:
            continue
        trust = float(views.trust[j, int(v + 0.5), int(u + 0.5)])
        if j == i:
            votes += rules.own_vote * likeness * trust
        elif abs(found - expected) <= slack(views.there[j], rules, x, y, inverse):
            votes += trust
        elif found < expected:
            votes -= trust  # this view sees through the place
    return votes


@compiled(error_model="numpy")
def _blend(inverse, views, rules, x, y, cost, rgb):  # type: ignore[no-untyped-def]
    """Set the colour (3,) of a place from the views that see it; returns whether there is one."""
    h, w = views.inverse.shape[1:]
    least = np.inf
    for j in range(len(views.inverse)):
        cost[j] = np.inf
        u, v, expected = land(views.there[j], x, y, inverse)
        found = _look(views.inverse[j], u, v) if expected >= 0 else -1.0
        if found >= 0 and abs(found - expected) <= slack(views.there[j], rules, x, y, inverse):
            cost[j] = unlikeness(views.there[j], rules, x, y, inverse)
            least = min(least, cost[j])
    if least == np.inf:
        return False
    r, g, b, weight = 0.0, 0.0, 0.0, 0.0
    for j in range(len(views.inverse)):
        if cost[j] == np.inf:
            continue
        u, v, _ = land(views.there[j], x, y, inverse)
        border = (min(min(u, v), min(w - 1 - u, h - 1 - v)) + 0.5) / rules.feather_px
        trust = float(views.trust[j, int(v + 0.5), int(u + 0.5)])
        share = (min(1.0, border) + SMALL) * (trust + SMALL) * np.exp(-(cost[j] - least) / rules.softness)
        red, green, blue = colour_at(views.images[j], u, v)
        r, g, b, weight = r + share * red, g + share * green, b + share * blue, weight + share
    rgb[0], rgb[1], rgb[2] = r / weight, g / weight, b / weight
    return True


@compiled(error_model="numpy", inline="always")
def _look(inverse, u, v):  # type: ignore[no-untyped-def]
    """Return a view's inverse depth at its pixel nearest to a place; NONE outside."""
    h, w = inverse.shape
    if not (u > -0.5 and v > -0.5 and u < w - 0.5 and v < h - 0.5):
        return float(NONE)
    return float(inverse[int(v + 0.5), int(u + 0.5)])


@compiled(error_model="numpy", inline="always")
def _pace(M, x, y, inverse):  # type: ignore[no-untyped-def]
    """Return by how many pixels a place moves in a view for each 1/m that its inverse depth there changes; and q2."""
    q2 = M[2, 0] * x + M[2, 1] * y + M[2, 2] + M[2, 3] * inverse
    u = (M[0, 0] * x + M[0, 1] * y + M[0, 2] + M[0, 3] * inverse) / q2
    v = (M[1, 0] * x + M[1, 1] * y + M[1, 2] + M[1, 3] * inverse) / q2
    return np.hypot(M[0, 3] - u * M[2, 3], M[1, 3] - v * M[2, 3]), q2


@compiled(error_model="numpy", inline="always")
def slack(M, rules, x, y, inverse):  # type: ignore[no-untyped-def]
    """Return by how much a view's inverse depth may differ from what is expected there and still agree, 1/m."""
    pace, q2 = _pace(M, x, y, inverse)
    share = max(rules.agree_share * inverse / q2, LEAST_INVERSE)
    return min(share, max(rules.agree_px / pace, 0.1 * share)) if pace > 0 else share


@compiled(error_model="numpy", inline="always")
def unlikeness(M, rules, x, y, inverse):  # type: ignore[no-untyped-def]
    """Return how unlike a view sees a place: by parallax, and by how much smaller."""
    pace, q2 = _pace(M, x, y, inverse)
    if not q2 > 0:
        return np.inf
    return pace * inverse / q2 / rules.parallax_px + rules.shrinking * max(np.log(q2), 0.0)


@compiled(error_model="numpy", inline="always")
def _cubic(f):  # type: ignore[no-untyped-def]
    """Return Catmull-Rom's four weights at a fraction f between two pixels (Catmull, Rom, 1974)."""
    return (
        f * (-0.5 + f * (1 - 0.5 * f)),
        1 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@compiled(error_model="numpy")
def colour_at(image, u, v):  # type: ignore[no-untyped-def]
    """Return the colour (3,) of an image (h, w, 3) at a place, by a cubic between its pixels."""
    h, w, _ = image.shape
    u, v = min(max(u, 0.0), w - 1.0), min(max(v, 0.0), h - 1.0)
    u0, v0 = int(u), int(v)
    across, down = _cubic(u - u0), _cubic(v - v0)
    r, g, b = 0.0, 0.0, 0.0
    for i in range(4):
        row = min(max(v0 + i - 1, 0), h - 1)
        for k in range(4):
            column = min(max(u0 + k - 1, 0), w - 1)
            share = down[i] * across[k]
            r += share * image[row, column, 0]
            g += share * image[row, column, 1]
            b += share * image[row, column, 2]
    return r, g, b
