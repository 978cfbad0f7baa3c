"""What single pixels are made of, compiled, and the way back from there."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.cpu.lanes import store
from nerf.kernels.cpu.splat_blend import Rules, alpha_of, corner, exponent, light, pixels
from nerf.kernels.cpu.splat_project import DEPTH, RECORD, REGION, TILE, Indices, Numbers, View, X, Y
from nerf.kernels.cpu.splat_region import TILES, Regions
from nerf.kernels.cpu.splat_unblend import GX, GXX, GXY, GY, GYY, G
from priors.machine.compiled import compiled

Places = npt.NDArray[np.int64]


class Packed(NamedTuple):
    """The parts of pixels, near to far; filled in place."""

    rows: Indices
    """(m,) of the view."""
    copies: Indices
    """(m,)"""
    alphas: Numbers
    """(m,)"""
    weights: Numbers
    """(m,)"""
    depths_m: Numbers
    """(m,) camera-z, uncapped."""


@compiled
def count(view: View, regions: Regions, rules: Rules, where: Places, found: Places, first: int, last: int) -> None:
    """Count of how many Gaussians the pixels first to last - 1 are made."""
    alphas, none = np.empty(16, np.float32), np.empty(0, np.int32)
    empty = np.empty(0, np.float32)
    for k in range(first, last):
        found[k] = _walk(view, regions, rules, where[k], alphas, Packed(none, none, empty, empty, empty), 0)


@compiled
def fill(
    view: View, regions: Regions, rules: Rules, where: Places, offsets: Places, out: Packed, first: int, last: int
) -> None:
    """Fill the parts of the pixels first to last - 1."""
    alphas = np.empty(16, np.float32)
    for k in range(first, last):
        _walk(view, regions, rules, where[k], alphas, out, offsets[k])


@compiled
def _walk(view, regions, rules, pixel, alphas, out, place):  # type: ignore[no-untyped-def]
    """Return how many Gaussians make a pixel, and write them from a place on where there is room."""
    width = rules.size[1]
    across, row, column = (width + REGION - 1) // REGION, pixel // width, pixel % width
    region = (row // REGION) * across + column // REGION
    tile = (row % REGION) // TILE * (REGION // TILE) + (column % REGION) // TILE
    lane = (row % TILE) * TILE + column % TILE
    left, top, _ = corner(rules.size, region, tile)
    x, y = pixels(left, top)
    rest, found, left_over = light(rules.size, x, y), 0, np.float32(1)
    start = regions.first_entry[region]
    for at in range(
        start + regions.ends[(TILES + 1) * region + tile], start + regions.ends[(TILES + 1) * region + tile + 1]
    ):
        if left_over < rules.enough:
            break
        member = 2 * (regions.first_member[region] + regions.entries[at])
        record = RECORD * np.int64(regions.members[member])
        alpha = alpha_of(exponent(view.records, record, x, y), rest, rules)
        weight = rest * alpha
        store(alphas, np.int64(0), alpha)
        rest = rest - weight
        if alphas[lane] > 0:
            if len(out.rows):
                out.rows[place + found], out.copies[place + found] = (
                    regions.members[member],
                    regions.members[member + 1],
                )
                out.alphas[place + found] = alphas[lane]
                store(alphas, np.int64(0), weight)
                out.weights[place + found] = alphas[lane]
                out.depths_m[place + found] = view.records[record + DEPTH]
            found += 1
            store(alphas, np.int64(0), rest)
            left_over = alphas[lane]
    return found


@compiled
def back(
    view: View, where: Places, width: int, offsets: Places, made: Packed, d_weights: Numbers, d_tau: Numbers,
    parts: Numbers,
) -> None:  # fmt: skip
    """Add to the copies' sums what derivatives by weights and optical depths say; empty ones are 0."""
    for k in range(len(where)):
        x, y = where[k] % width, where[k] // width
        behind = 0.0
        if len(d_weights):
            for i in range(offsets[k], offsets[k + 1]):
                behind += float(made.weights[i]) * d_weights[i]
        for i in range(offsets[k], offsets[k + 1]):
            alpha, g = float(made.alphas[i]), 0.0
            through = alpha / (1 - alpha)
            if len(d_weights):
                own = float(made.weights[i]) * d_weights[i]
                behind -= own
                g += own - behind * through
            if len(d_tau):
                g += d_tau[i] * through
            if made.alphas[i] >= np.float32(MOST_ALPHA):
                continue
            record, copy = RECORD * np.int64(made.rows[i]), RECORD * np.int64(made.copies[i])
            dx, dy = x - float(view.records[record + X]), y - float(view.records[record + Y])
            parts[copy + G] += g
            parts[copy + GX] += g * dx
            parts[copy + GY] += g * dy
            parts[copy + GXX] += g * dx * dx
            parts[copy + GXY] += g * dx * dy
            parts[copy + GYY] += g * dy * dy
