"""What single pixels are made of, on GPUs, a pixel a program and a Gaussian a thread, and the way back from there."""

import triton
import triton.language as tl

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.triton import splat_blend as blend
from nerf.kernels.triton import splat_project as record
from nerf.kernels.triton import splat_unblend as of

_MOST_ALPHA = tl.constexpr(MOST_ALPHA)


@triton.jit
def walk(  # type: ignore[no-untyped-def]
    records, members, starts, least_log, enough, width, across, where, offsets, counts, which, alphas, weights,
    depths_m, FILL: tl.constexpr, COUNT: tl.constexpr,
):  # fmt: skip
    """Count the Gaussians that make each pixel: counts (r,); or FILL the parts of all pixels, from offsets on.

    where: (r,) the pixels' numbers. Parts: which Gaussian in view, alpha, weight and depth, (m,) near first.
    """
    r = tl.program_id(0)
    pixel = tl.load(where + r).to(tl.int32)
    column, row = pixel % width + tl.arange(0, 1), pixel // width + tl.arange(0, 1)
    tile = pixel // width // blend.SIDE * across + pixel % width // blend.SIDE
    at, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    rest = tl.full([1], 1.0, tl.float32)
    most = tl.max(rest, axis=0)
    found = tl.zeros([1], tl.int64)
    if FILL:
        found += tl.load(offsets + r)
    while (at < end) & (most >= enough):
        who, own, here = blend.chunk(members, at, end, records, COUNT)
        _, _, alpha, odds, weight, after = blend.stopped(own, here, column, row, rest, least_log, enough)
        there = odds > 0
        if FILL:
            place = found[None, :] + tl.cumsum(there.to(tl.int32), axis=0) - 1
            tl.store(which + place, who[:, None].to(tl.int32), mask=there)
            tl.store(alphas + place, tl.minimum(alpha, _MOST_ALPHA), mask=there)
            tl.store(weights + place, weight, mask=there)
            tl.store(depths_m + place, blend.column_of(own, here, record.DEPTH), mask=there)
        found += tl.sum(there.to(tl.int32), axis=0)
        rest = tl.min(after, axis=0)
        most = tl.max(rest, axis=0)
        at += COUNT
    if not FILL:
        tl.store(counts + r + tl.arange(0, 1), found)


@triton.jit
def back(  # type: ignore[no-untyped-def]
    records, where, width, offsets, which, alphas, weights, d_weights, d_tau, sums, COUNT: tl.constexpr
):
    """Add to the Gaussians' sums what derivatives by weights and optical depths say; sums over a ray in float64."""
    r = tl.program_id(0)
    pixel = tl.load(where + r).to(tl.int32)
    column, row = (pixel % width).to(tl.float32), (pixel // width).to(tl.float32)
    first, end = tl.load(offsets + r), tl.load(offsets + r + 1)
    lane = tl.arange(0, COUNT)
    behind = tl.zeros([1], tl.float64)
    for at in range(first, end, COUNT):
        here = at + lane < end
        behind += tl.sum(_pull(weights, d_weights, at + lane, here), axis=0)
    for at in range(first, end, COUNT):
        i = at + lane
        here = i < end
        alpha = tl.load(alphas + i, mask=here, other=0.0).to(tl.float64)
        odds, pull = alpha / (1 - alpha), _pull(weights, d_weights, i, here)
        g = pull - (behind - tl.cumsum(pull, axis=0)) * odds + tl.load(d_tau + i, mask=here, other=0.0) * odds
        behind -= tl.sum(pull, axis=0)
        usable = here & (tl.load(alphas + i, mask=here, other=0.0) < _MOST_ALPHA)
        k = tl.load(which + i, mask=here, other=0).to(tl.int64)
        _add(sums + of.SUMS * k, records + record.RECORD * k, column, row, g.to(tl.float32), usable)


@triton.jit
def _pull(weights, d_weights, i, here):  # type: ignore[no-untyped-def]
    """Return each part's weight times its derivative, float64."""
    weight = tl.load(weights + i, mask=here, other=0.0).to(tl.float64)
    return weight * tl.load(d_weights + i, mask=here, other=0.0)


@triton.jit
def _add(to, own, column, row, g, usable):  # type: ignore[no-untyped-def]
    """Add a pixel's derivatives by its Gaussians' exponents to their sums."""
    dx = column - tl.load(own + record.X, mask=usable, other=0.0)
    dy = row - tl.load(own + record.Y, mask=usable, other=0.0)
    tl.atomic_add(to + of.G, g, mask=usable, sem="relaxed")
    tl.atomic_add(to + of.GX, g * dx, mask=usable, sem="relaxed")
    tl.atomic_add(to + of.GY, g * dy, mask=usable, sem="relaxed")
    tl.atomic_add(to + of.GXX, g * dx * dx, mask=usable, sem="relaxed")
    tl.atomic_add(to + of.GXY, g * dx * dy, mask=usable, sem="relaxed")
    tl.atomic_add(to + of.GYY, g * dy * dy, mask=usable, sem="relaxed")
