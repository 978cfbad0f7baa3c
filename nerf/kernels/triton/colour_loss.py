"""L1 and SSIM of pictures with their derivative on GPUs. Equals nerf/twin/colour_loss.py.

A thread takes one number of a picture: a channel of a pixel. A window's 11 x 11 numbers come from the caches.
"""

import triton
import triton.language as tl

from nerf.twin.colour_loss import C1, C2, WINDOW

_C1, _C2, _WINDOW = tl.constexpr(C1), tl.constexpr(C2), tl.constexpr(WINDOW)


@triton.jit
def compare(  # type: ignore[no-untyped-def]
    rgb, truth, weight, taps, totals, share, height, width, count, maps, unlike, BLOCK: tl.constexpr
):
    """Fill maps (3, count), the derivatives by each window's mean of rgb, of its square and of rgb times truth.

    And unlike (programs,), sums of weight (1 - SSIM). A window is a number of (height - 10, width - 10, 3).
    totals: (2,) sums of all weights and of the windows', times 3. share: of 1 - SSIM in the loss.
    """
    e = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = e < count
    line = 3 * (width - _WINDOW + 1)
    row, column = e // line, e % line
    none = tl.zeros([BLOCK], tl.float32)
    mx, my, both, cross = none, none, none, none
    for k in range(_WINDOW):
        for j in range(_WINDOW):
            tap = tl.load(taps + k) * tl.load(taps + j)
            at = (row + k) * 3 * width + column + 3 * j
            x, y = tl.load(rgb + at, mask=here, other=0.0), tl.load(truth + at, mask=here, other=0.0)
            mx += tap * x
            my += tap * y
            both += tap * (x * x + y * y)
            cross += tap * (x * y)
    common, squares = mx * my, mx * mx + my * my
    a1, a2 = 2 * common + _C1, 2 * (cross - common) + _C2
    b1, b2 = squares + _C1, both - squares + _C2
    ssim = a1 * a2 / (b1 * b2)
    middle = (row + _WINDOW // 2) * width + column // 3 + _WINDOW // 2
    own = tl.load(weight + middle, mask=here, other=0.0)
    tl.store(unlike + tl.program_id(0), tl.sum(own * (1 - ssim), axis=0))
    scale = own * (share / tl.load(totals + 1)) / (b1 * b2)
    tl.store(maps + e, scale * 2 * (mx * ssim * (b2 - b1) - my * (a2 - a1)), mask=here)
    tl.store(maps + count + e, scale * ssim * b1, mask=here)
    tl.store(maps + 2 * count + e, -2 * scale * a1, mask=here)


@triton.jit
def differ(  # type: ignore[no-untyped-def]
    rgb, truth, weight, taps, totals, share, height, width, numbers, count, maps, d_rgb, apart,
    SSIM: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill d_rgb (numbers,), and apart (programs,), sums of weight |rgb - truth|; maps: of `compare`."""
    e = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = e < numbers
    row, column = e // (3 * width), e % (3 * width)
    x, y = tl.load(rgb + e, mask=here, other=0.0), tl.load(truth + e, mask=here, other=0.0)
    off, own = x - y, tl.load(weight + e // 3, mask=here, other=0.0)
    tl.store(apart + tl.program_id(0), tl.sum(own * tl.abs(off), axis=0))
    sign = tl.where(off > 0, 1.0, tl.where(off < 0, -1.0, 0.0))
    d = own * sign * ((1 - share) / tl.load(totals))
    if SSIM:
        line = 3 * (width - _WINDOW + 1)
        for k in range(_WINDOW):
            for j in range(_WINDOW):
                first, side = row - k, column - 3 * j
                inside = here & (first >= 0) & (first < height - _WINDOW + 1) & (side >= 0) & (side < line)
                at = maps + first * line + side
                pull = tl.load(at, mask=inside, other=0.0) + 2 * x * tl.load(at + count, mask=inside, other=0.0)
                pull += y * tl.load(at + 2 * count, mask=inside, other=0.0)
                d += tl.load(taps + k) * tl.load(taps + j) * pull
    tl.store(d_rgb + e, d, mask=here)
