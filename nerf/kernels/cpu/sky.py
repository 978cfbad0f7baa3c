"""Environment map, compiled: bit for bit what nerf/twin/sky.py computes in float32, a ray at a time.

No fast-math, and every constant is a float32: Python's own numbers would make a double of all they touch.
"""

import numpy as np

from priors.machine.compiled import compiled

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@compiled(error_model="numpy", inline="always")
def _place(x, y, z):  # type: ignore[no-untyped-def]
    """Return where a direction lies in a picture, [0, 1] x [0, 1]."""
    total = abs(x) + abs(y) + abs(z)
    x, y, z = x / total, y / total, z / total
    u, v = x, y
    if z < ZERO:
        u = (ONE - abs(y)) * (-ONE if x < ZERO else ONE)
        v = (ONE - abs(x)) * (-ONE if y < ZERO else ONE)
    return u * HALF + HALF, v * HALF + HALF


@compiled(error_model="numpy", inline="always")
def _corners(u, v, size, start, rows, shares):  # type: ignore[no-untyped-def]
    """Fill the rows (4,) and shares (4,) of the texels of one picture around a place."""
    last = np.float32(size - 1)
    x, y = u * last, v * last
    left = min(max(np.floor(x), ZERO), np.float32(size - 2))
    top = min(max(np.floor(y), ZERO), np.float32(size - 2))
    right, down = x - left, y - top
    first = start + int(top) * size + int(left)
    rows[0], rows[1], rows[2], rows[3] = first, first + size, first + 1, first + size + 1
    shares[0], shares[1] = (ONE - right) * (ONE - down), (ONE - right) * down
    shares[2], shares[3] = right * (ONE - down), right * down


@compiled(error_model="numpy")
def look(texels, units, sizes, sums, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Fill the sums (r, 3) of the pictures (texels, 3) in directions (r, 3)."""
    rows, shares = np.empty(4, np.int64), np.empty(4, np.float32)
    part = np.empty((4, 3), np.float32)  # of each corner, over the pictures: the order in which PyTorch adds them
    for ray in range(first_ray, last_ray):
        u, v = _place(units[ray, 0], units[ray, 1], units[ray, 2])
        for k in range(4):
            part[k, 0], part[k, 1], part[k, 2] = ZERO, ZERO, ZERO
        start = 0
        for size in sizes:
            _corners(u, v, size, start, rows, shares)
            for k in range(4):
                for c in range(3):
                    part[k, c] += texels[rows[k], c] * shares[k]
            start += size * size
        for c in range(3):
            sums[ray, c] = part[0, c] + part[1, c] + part[2, c] + part[3, c]


@compiled(error_model="numpy")
def paint(d_sums, units, sizes, d_texels):  # type: ignore[no-untyped-def]
    """Set the gradient (texels, 3) from that of the sums, (r, 3); one task: its sums are in the rays' order."""
    rows, shares = np.empty(4, np.int64), np.empty(4, np.float32)
    for row in range(d_texels.shape[0]):
        d_texels[row, 0], d_texels[row, 1], d_texels[row, 2] = ZERO, ZERO, ZERO
    for ray in range(units.shape[0]):
        u, v = _place(units[ray, 0], units[ray, 1], units[ray, 2])
        start = 0
        for size in sizes:
            _corners(u, v, size, start, rows, shares)
            for k in range(4):
                for c in range(3):
                    d_texels[rows[k], c] += shares[k] * d_sums[ray, c]
            start += size * size
