"""Neighbouring frames' maps looked up along a frame's rays; its slow twin is in tests/test_fusion.py."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

ONE_SURFACE = 0.05
"""Four pixels are of one surface where their inverse depths lie within this share of each other."""


@compiled(fastmath=FAST, error_model="numpy")
def look_up(
    depth_m: FloatMap,
    other_m: FloatMap,
    there: npt.NDArray[np.float64],
    back: npt.NDArray[np.float64],
    found: FloatMap,
    place: npt.NDArray[np.int32],
    first: int,
    last: int,
) -> None:
    """Write what another frame's map says of each value of a map (height, width), in rows first to last - 1.

    Args:
        depth_m: the frame's own map, metres; 0 = no value.
        other_m: (height, width) the other frame's, of any size.
        there: (3, 4) maps (x z, y z, z, 1) of the frame's pixel (x, y) and depth z to those of the other frame.
        back: (3, 4) the way back.
        found: written: ln(z' / z) with the depth z' that the other map gives along the frame's own ray; NaN where it
            has none to give.
        place: written: the index of the other map's pixel that was looked at; -1 where there is none.
    """
    width = depth_m.shape[1]
    rows, columns = other_m.shape
    for row in range(first, last):
        for column in range(width):
            z = depth_m[row, column]
            found[row, column] = np.nan
            place[row, column] = -1
            if not z > 0:
                continue
            a, b = column * z, row * z
            w = there[2, 0] * a + there[2, 1] * b + there[2, 2] * z + there[2, 3]
            if not w > 0:
                continue
            u = (there[0, 0] * a + there[0, 1] * b + there[0, 2] * z + there[0, 3]) / w
            v = (there[1, 0] * a + there[1, 1] * b + there[1, 2] * z + there[1, 3]) / w
            if not (u > -0.5 and v > -0.5 and u < columns - 0.5 and v < rows - 0.5):
                continue
            y = _between(other_m, u, v)
            if not y > 0:
                continue
            again = back[2, 0] * u * y + back[2, 1] * v * y + back[2, 2] * y + back[2, 3]
            if not again > 0:
                continue
            found[row, column] = np.log(again / z)
            place[row, column] = int(v + 0.5) * columns + int(u + 0.5)


@compiled(fastmath=FAST, error_model="numpy")
def _between(depth_m: FloatMap, u: float, v: float) -> float:
    """Return the depth at a place in a map: bilinear in inverse depth on one surface, else the nearest pixel's."""
    rows, columns = depth_m.shape
    nearest = depth_m[int(v + 0.5), int(u + 0.5)]
    left, top = int(max(u, 0.0)), int(max(v, 0.0))
    right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
    p, q, r, s = depth_m[top, left], depth_m[top, right], depth_m[bottom, left], depth_m[bottom, right]
    least, most = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
    if not least > 0 or least < most * (1 - ONE_SURFACE):
        return nearest
    a, b = max(u - left, 0.0), max(v - top, 0.0)
    return 1 / ((1 - b) * ((1 - a) / p + a / q) + b * ((1 - a) / r + a / s))
