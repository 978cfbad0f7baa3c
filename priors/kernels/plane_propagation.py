"""Plane propagation: samples bring their planes to the pixels around them, the image says how far each holds.

Every sample visits whole runs of LANES columns, so that the inner loops have a fixed length and compile to vector code;
maps are therefore padded by at least the reach on all sides, and nothing is clipped.

Arguments of both:
    row, column: (n,) samples' pixels in the padded maps.
    inverse, slope_y, slope_x: (n,) their planes in inverse depth, 1/m and 1/(m px).
    handicap: (n,) cost that a sample starts with.
    reach_y, runs: rows up and down; runs of LANES columns, centred on the sample.
    per_y, per_x: a sample costs handicap + per_y dy^2 + per_x dx^2 + contrast * (difference in guide, (h, w) grey)^2.
"""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled

LANES = 16
NEAR = np.float32(0.05)  # cost below which cheaper is not heavier
NOTHING = np.float32(1e30)  # what a pixel costs that no sample visits
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)

Ints: TypeAlias = npt.NDArray[np.int32]
Floats: TypeAlias = npt.NDArray[np.float32]
Bytes: TypeAlias = npt.NDArray[np.uint8]


@compiled(fastmath=FAST, error_model="numpy")
def assign(
    row: Ints,
    column: Ints,
    inverse: Floats,
    slope_y: Floats,
    slope_x: Floats,
    handicap: Floats,
    reach_y: int,
    runs: int,
    per_y: float,
    per_x: float,
    guide: Bytes,
    contrast: float,
    cost: Floats,
    value: Floats,
) -> None:
    """Give every pixel the plane of its cheapest sample: updates cost (starts at NOTHING) and value, 1/m, (h, w)."""
    width = cost.shape[1]
    guides, costs, values = guide.ravel(), cost.ravel(), value.ravel()
    for i in range(len(row)):
        y, x = row[i], column[i]
        grey = np.float32(guides[y * width + x])
        for run in range(runs):
            left = LANES * run - LANES * runs // 2
            for dy in range(-reach_y, reach_y + 1):
                first = np.uint64((y + dy) * width + x + left)
                down = np.float32(dy)
                plane = inverse[i] + slope_y[i] * down + slope_x[i] * np.float32(left)
                start = handicap[i] + down * down * per_y
                for j in range(LANES):
                    p = first + np.uint64(j)
                    across = np.float32(left + j)
                    off = np.float32(guides[p]) - grey
                    here = start + across * across * per_x + contrast * off * off
                    better = here < costs[p]
                    values[p] = plane + slope_x[i] * np.float32(j) if better else values[p]
                    costs[p] = here if better else costs[p]


@compiled(fastmath=FAST, error_model="numpy")
def average(
    row: Ints,
    column: Ints,
    inverse: Floats,
    slope_y: Floats,
    slope_x: Floats,
    handicap: Floats,
    reach_y: int,
    runs: int,
    per_y: float,
    per_x: float,
    value: Floats,
    agree: float,
    agree_per_m: float,
    top: Floats,
    bottom: Floats,
) -> None:
    """Sum the planes around every pixel that agree with value (h, w), 1/m, the plane it chose.

    A plane weighs 1 / (NEAR + cost)^2 (cost as above, without contrast) times Geman-McClure of its difference to value
    in units of agree * value + agree_per_m. Updates top and bottom (h, w): sums of weighted inverse depth, of weights.
    """
    width = value.shape[1]
    values, tops, bottoms = value.ravel(), top.ravel(), bottom.ravel()
    for i in range(len(row)):
        y, x = row[i], column[i]
        for run in range(runs):
            left = LANES * run - LANES * runs // 2
            for dy in range(-reach_y, reach_y + 1):
                first = np.uint64((y + dy) * width + x + left)
                down = np.float32(dy)
                plane = inverse[i] + slope_y[i] * down + slope_x[i] * np.float32(left)
                start = NEAR + handicap[i] + down * down * per_y
                for j in range(LANES):
                    p = first + np.uint64(j)
                    across = np.float32(left + j)
                    there = plane + slope_x[i] * np.float32(j)
                    off = there - values[p]
                    slack = agree * values[p] + agree_per_m
                    slack *= slack
                    weight = slack / ((start + across * across * per_x) * (slack + off * off))
                    weight *= weight
                    tops[p] += weight * there
                    bottoms[p] += weight


@compiled(fastmath=FAST, error_model="numpy")
def fill_holes(
    cost: Floats, top: Floats, bottom: Floats, pad: int, coarse: Floats, sure: Floats, coarse_pad: int, step: int
) -> None:
    """Turn top (padded) into inverse depth and cost into certainty, in (0, 1]; holes come from a smaller map.

    coarse and sure are that map, settled and padded too, step times smaller, read bilinearly; what is filled in is half
    as certain.
    """
    height, width = cost.shape[0] - 2 * pad, cost.shape[1] - 2 * pad
    rows, columns = coarse.shape[0] - 2 * coarse_pad, coarse.shape[1] - 2 * coarse_pad
    line, line_sure = np.empty(columns + 1, np.float32), np.empty(columns + 1, np.float32)
    for y in range(height):
        costs, tops = cost[y + pad, pad : pad + width], top[y + pad, pad : pad + width]
        bottoms = bottom[y + pad, pad : pad + width]
        v = min(max((y + 0.5) / step - 0.5, 0.0), rows - 1.0)
        b = np.float32(v - int(v))
        above = coarse_pad + int(v)
        below = min(above + 1, coarse_pad + rows - 1)
        for c in range(columns):
            x = coarse_pad + c
            line[c] = coarse[above, x] + b * (coarse[below, x] - coarse[above, x])
            line_sure[c] = HALF * (sure[above, x] + b * (sure[below, x] - sure[above, x]))
        line[columns], line_sure[columns] = line[columns - 1], line_sure[columns - 1]
        for x in range(width):
            if costs[x] >= NOTHING:
                u = min(max((np.float32(x) + HALF) / np.float32(step) - HALF, ZERO), np.float32(columns - 1))
                c = int(u)
                a = u - np.float32(c)
                tops[x], bottoms[x] = line[c] + a * (line[c + 1] - line[c]), ONE
                costs[x] = ONE / (line_sure[c] + a * (line_sure[c + 1] - line_sure[c])) - ONE
        for x in range(width):
            tops[x] /= bottoms[x]
            costs[x] = ONE / (ONE + costs[x])


@compiled(fastmath=FAST, error_model="numpy")
def to_depth(
    crisp: Floats,
    soft: Floats,
    certain: Floats,
    pad: int,
    near: Bytes,
    least: float,
    most: float,
    edge: float,
    depth_m: Floats,
    confidence: Floats,
) -> None:
    """Turn inverse depth into depth and confidence (height, width), 0 where near (height, width) is 0.

    Args:
        crisp, soft: inverse depth before and after the blur; confidence halves where they differ by the share 1 / edge.
        certain, pad: see fill_holes.
        near: 1 where a value has support.
        least, most: range of inverse depth, 1/m.
        edge: see crisp.
        depth_m, confidence: filled in.
    """
    height, width = crisp.shape
    for y in range(height):
        certainty = certain[y + pad, pad : pad + width]
        for x in range(width):  # two loops: vector code gives up on more than a few arrays
            depth_m[y, x] = np.float32(near[y, x]) / min(max(soft[y, x], least), most)
        for x in range(width):
            before = max(crisp[y, x], least)  # planes through far too few samples run below 0
            crispness = before / (before + edge * abs(soft[y, x] - before))
            confidence[y, x] = np.float32(near[y, x]) * certainty[x] * crispness
