"""The way back through blending on GPUs: what a loss's derivatives by the picture say about each Gaussian's record.

A tile goes near to far once more; see nerf/kernels/cpu/splat_unblend.py for the formula. A warp has some rows of a
tile, sums a chunk's derivatives over its pixels, and adds them to the Gaussians' sums by atomic additions, in no fixed
order.
"""

import triton
import triton.language as tl

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.triton import splat_blend as blend
from nerf.kernels.triton import splat_project as record

SUM_NUMBERS = 10
G, GX, GY, GXX, GXY, GYY = (tl.constexpr(k) for k in range(6))
D_RED, D_DEPTH = tl.constexpr(6), tl.constexpr(9)
"""What stands where in a Gaussian's sums: g times what, and the derivatives by the colour and by min(z, cap)."""
SUMS = tl.constexpr(SUM_NUMBERS)
_MOST_ALPHA = tl.constexpr(MOST_ALPHA)


@triton.jit
def undraw(  # type: ignore[no-untyped-def]
    records, members, starts, least_log, enough, width, height, across, rgb, depth_sum, opacity,
    d_rgb, d_depth, d_opacity, sums, ROWS: tl.constexpr, COUNT: tl.constexpr,
):  # fmt: skip
    """Add to the sums (v, SUMS) what the picture's derivatives say; rgb is that before black."""
    tile, column, row, pixel, inside = blend.pixels(width, height, across, ROWS)
    at, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    rest = inside.to(tl.float32)
    d_red = tl.load(d_rgb + 3 * pixel, mask=inside, other=0.0)
    d_green = tl.load(d_rgb + 3 * pixel + 1, mask=inside, other=0.0)
    d_blue = tl.load(d_rgb + 3 * pixel + 2, mask=inside, other=0.0)
    d_moment = tl.load(d_depth + pixel, mask=inside, other=0.0)
    d_stopped = tl.load(d_opacity + pixel, mask=inside, other=0.0)
    # sum w q of the Gaussians that are still to come
    ahead = d_red * tl.load(rgb + 3 * pixel, mask=inside, other=0.0)
    ahead += d_green * tl.load(rgb + 3 * pixel + 1, mask=inside, other=0.0)
    ahead += d_blue * tl.load(rgb + 3 * pixel + 2, mask=inside, other=0.0)
    ahead += d_moment * tl.load(depth_sum + pixel, mask=inside, other=0.0)
    ahead += d_stopped * tl.load(opacity + pixel, mask=inside, other=0.0)
    most = tl.max(rest, axis=0)
    while (at < end) & (most >= enough):
        which, own, here = blend.chunk(members, at, end, records, COUNT)
        dx, dy, alpha, odds, weight, after = blend.stopped(own, here, column, row, rest, least_log, enough)
        q = d_stopped[None, :] + d_red[None, :] * blend.column_of(own, here, record.RED)
        q += d_green[None, :] * blend.column_of(own, here, record.RED + 1)
        q += d_blue[None, :] * blend.column_of(own, here, record.RED + 2)
        q += d_moment[None, :] * blend.column_of(own, here, record.CAPPED)
        pull = weight * q
        behind = ahead[None, :] - tl.cumsum(pull, axis=0)
        g = tl.where(alpha > _MOST_ALPHA, 0.0, pull - behind * odds)
        to = sums + SUMS * which
        gx, gy = g * dx, g * dy
        tl.atomic_add(to + G, tl.sum(g, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + GX, tl.sum(gx, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + GY, tl.sum(gy, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + GXX, tl.sum(gx * dx, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + GXY, tl.sum(gx * dy, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + GYY, tl.sum(gy * dy, axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + D_RED, tl.sum(weight * d_red[None, :], axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + D_RED + 1, tl.sum(weight * d_green[None, :], axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + D_RED + 2, tl.sum(weight * d_blue[None, :], axis=1), mask=here, sem="relaxed")
        tl.atomic_add(to + D_DEPTH, tl.sum(weight * d_moment[None, :], axis=1), mask=here, sem="relaxed")
        ahead -= tl.sum(pull, axis=0)
        rest = tl.min(after, axis=0)
        most = tl.max(rest, axis=0)
        at += COUNT
