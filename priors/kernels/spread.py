"""Kernels that spread samples over the pixels around them: each brings its plane, the image says how far it holds.

Every sample visits whole runs of LANES columns, so that the inner loops have a fixed length and compile to vector code;
maps are therefore padded on all sides by at least the reach (in multiples of LANES) and nothing is clipped.
Cost of a sample at a pixel: (dy/gap_y)^2 + (dx/gap_x)^2 + colour * squared RGB difference.
"""

import numpy as np
from numba import njit

LANES = 16
ZERO, ONE = np.float32(0), np.float32(1)
NEAR = np.float32(0.05)  # cost below which being nearer is no merit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def choose(row, column, inverse, slope_y, slope_x, guide, reach_y, runs, per_y, per_x, colour, cost, value, total):
    """Give every pixel the plane of its cheapest sample.

    Args:
        row, column: (n,) in the padded maps.
        inverse, slope_y, slope_x: (n,) planes in inverse depth, 1/m and 1/(m px).
        guide: (3, h, w) uint8, padded.
        reach_y, runs: rows up and down, runs of LANES columns left and right of the sample's own half.
        per_y, per_x: 1 / gap^2, px^-2.
        colour: cost of a squared RGB difference.
        cost, value, total: (h, w) float32, updated: lowest cost, that plane's inverse depth, sum of weights.
    """
    for i in range(len(row)):
        y, x = row[i], column[i]
        red, green, blue = (
            np.float32(guide[0, y, x]),
            np.float32(guide[1, y, x]),
            np.float32(guide[2, y, x]),
        )
        for run in range(runs):
            left = x + LANES * run - (LANES * runs) // 2
            for r in range(y - reach_y, y + reach_y + 1):
                dy = np.float32(r - y)
                start = inverse[i] + slope_y[i] * dy + slope_x[i] * np.float32(left - x)
                away = dy * dy * per_y
                g = guide[:, r, left : left + LANES]
                c, v, t = cost[r, left : left + LANES], value[r, left : left + LANES], total[r, left : left + LANES]
                for j in range(LANES):
                    dx = np.float32(left - x + j)
                    dr, dg, db = np.float32(g[0, j]) - red, np.float32(g[1, j]) - green, np.float32(g[2, j]) - blue
                    here = away + dx * dx * per_x + colour * (dr * dr + dg * dg + db * db)
                    better = here < c[j]
                    v[j] = start + slope_x[i] * np.float32(j) if better else v[j]
                    c[j] = here if better else c[j]
                    near = ONE / (NEAR + here)
                    t[j] += near * near


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def blend(
    row, column, inverse, slope_y, slope_x, guide, reach_y, runs, per_y, per_x, colour, value, sharp, top, bottom
):
    """Average the planes that agree with the chosen value; arguments as in choose.

    Weights are 1 / (NEAR + cost)^2 times Geman-McClure of the difference to value, times sharp (m).

    Updates top and bottom (h, w) float32: the weighted sum of inverse depth, and of weights.
    """
    for i in range(len(row)):
        y, x = row[i], column[i]
        red, green, blue = (
            np.float32(guide[0, y, x]),
            np.float32(guide[1, y, x]),
            np.float32(guide[2, y, x]),
        )
        for run in range(runs):
            left = x + LANES * run - (LANES * runs) // 2
            for r in range(y - reach_y, y + reach_y + 1):
                dy = np.float32(r - y)
                start = inverse[i] + slope_y[i] * dy + slope_x[i] * np.float32(left - x)
                away = dy * dy * per_y
                g = guide[:, r, left : left + LANES]
                v, a, b = value[r, left : left + LANES], top[r, left : left + LANES], bottom[r, left : left + LANES]
                for j in range(LANES):
                    dx = np.float32(left - x + j)
                    dr, dg, db = np.float32(g[0, j]) - red, np.float32(g[1, j]) - green, np.float32(g[2, j]) - blue
                    here = away + dx * dx * per_x + colour * (dr * dr + dg * dg + db * db)
                    near = ONE / (NEAR + here)
                    plane = start + slope_x[i] * np.float32(j)
                    off = (plane - v[j]) * sharp
                    agree = ONE / (ONE + off * off)
                    weight = near * near * agree * agree
                    a[j] += weight * plane
                    b[j] += weight
