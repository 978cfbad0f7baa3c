"""A Gaussian's shape in the image on GPUs, a Gaussian a thread: what projecting and its way back both need.

Equals nerf/twin/splat.py, `project`. Vectors and matrices are tuples, row by row. A lens is an array of 24 numbers:
nerf/kernels/lens.py in its order, as far as it holds float32.
"""

import math

import triton
import triton.language as tl

from nerf.gaussians.types import LEAST_TURN, MOST_M, MOST_SPREAD_PX

RIGHT, DOWN, AHEAD, CENTRE = tl.constexpr(0), tl.constexpr(3), tl.constexpr(6), tl.constexpr(9)
FOCAL, MIDDLE, REACH_X, REACH_Y = tl.constexpr(12), tl.constexpr(14), tl.constexpr(16), tl.constexpr(18)
LOW_PASS, LEAST_ALPHA, NEAR, CAP = tl.constexpr(20), tl.constexpr(21), tl.constexpr(22), tl.constexpr(23)
"""Where a lens has what."""
_LEAST_TURN, _LOG_MOST_M = tl.constexpr(LEAST_TURN), tl.constexpr(math.log(MOST_M))
_MOST_SPREAD_PX = tl.constexpr(MOST_SPREAD_PX)


@triton.jit
def three(array, at, here):  # type: ignore[no-untyped-def]
    """Return three numbers that lie side by side, from places `at` on; 0 where not `here`."""
    return (
        tl.load(array + at, mask=here, other=0.0),
        tl.load(array + at + 1, mask=here, other=0.0),
        tl.load(array + at + 2, mask=here, other=0.0),
    )


@triton.jit
def store_three(array, at, vector, here):  # type: ignore[no-untyped-def]
    """Write a vector to places `at` and the next two."""
    tl.store(array + at, vector[0], mask=here)
    tl.store(array + at + 1, vector[1], mask=here)
    tl.store(array + at + 2, vector[2], mask=here)


@triton.jit
def axis(lens, which):  # type: ignore[no-untyped-def]
    """Return three numbers of a lens: an axis of the camera in the scene's frame, or its centre."""
    return tl.load(lens + which), tl.load(lens + which + 1), tl.load(lens + which + 2)


@triton.jit
def dot(a, b):  # type: ignore[no-untyped-def]
    """Return the product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@triton.jit
def cross(a, b):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@triton.jit
def times(a, scale):  # type: ignore[no-untyped-def]
    """Return a vector times a number."""
    return a[0] * scale, a[1] * scale, a[2] * scale


@triton.jit
def plus(a, b):  # type: ignore[no-untyped-def]
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@triton.jit
def minus(a, b):  # type: ignore[no-untyped-def]
    """Return the difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@triton.jit
def divided(a, number):  # type: ignore[no-untyped-def]
    """Return a vector divided by a number."""
    return a[0] / number, a[1] / number, a[2] / number


@triton.jit
def place(means_m, lens, i, here):  # type: ignore[no-untyped-def]
    """Return where means are in the camera's frame, metres, and whence they are seen: mean less centre."""
    away = minus(three(means_m, 3 * i, here), axis(lens, CENTRE))
    return (dot(axis(lens, RIGHT), away), dot(axis(lens, DOWN), away), dot(axis(lens, AHEAD), away)), away


@triton.jit
def quaternion(rotations, i, here):  # type: ignore[no-untyped-def]
    """Return unit quaternions (w, x, y, z) and what they were divided by, inverted: 0 for those that are none."""
    w = tl.load(rotations + 4 * i, mask=here, other=0.0)
    x, y, z = three(rotations, 4 * i + 1, here)
    longest = tl.maximum(tl.maximum(tl.abs(w), tl.abs(x)), tl.maximum(tl.abs(y), tl.abs(z)))
    longest = tl.maximum(longest, _LEAST_TURN)
    w, x, y, z = w / longest, x / longest, y / longest, z / longest  # float32 holds no square of 1e20
    squared = w * w + x * x + y * y + z * z
    usable = squared * longest * longest > _LEAST_TURN
    inverse = tl.where(usable, 1 / tl.sqrt(tl.where(usable, squared, 1.0)), 0.0)
    return (w * inverse, x * inverse, y * inverse, z * inverse), inverse / longest


@triton.jit
def turned(lens, q):  # type: ignore[no-untyped-def]
    """Return the Gaussian's unit axes in the camera's frame, (3, 3), an axis a column."""
    w, x, y, z = q
    first = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)  # columns in the scene's frame
    second = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    third = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    right, down, ahead = axis(lens, RIGHT), axis(lens, DOWN), axis(lens, AHEAD)
    return (
        (dot(right, first), dot(right, second), dot(right, third)),
        (dot(down, first), dot(down, second), dot(down, third)),
        (dot(ahead, first), dot(ahead, second), dot(ahead, third)),
    )


@triton.jit
def scales(log_scales, i, here):  # type: ignore[no-untyped-def]
    """Return the standard deviations along the axes, metres, held to MOST_M, and which are not held."""
    a, b, c = three(log_scales, 3 * i, here)
    free = a <= _LOG_MOST_M, b <= _LOG_MOST_M, c <= _LOG_MOST_M
    most = _LOG_MOST_M
    held = tl.where(a > most, most, a), tl.where(b > most, most, b), tl.where(c > most, most, c)  # NaN stays NaN
    return (tl.exp(held[0]), tl.exp(held[1]), tl.exp(held[2])), free


@triton.jit
def scaled(u, s):  # type: ignore[no-untyped-def]
    """Return a matrix whose columns are multiplied by numbers."""
    return (
        (u[0][0] * s[0], u[0][1] * s[1], u[0][2] * s[2]),
        (u[1][0] * s[0], u[1][1] * s[1], u[1][2] * s[2]),
        (u[2][0] * s[0], u[2][1] * s[1], u[2][2] * s[2]),
    )


@triton.jit
def held(value, lens, which):  # type: ignore[no-untyped-def]
    """Return slopes held to where a shape is taken, and whether they are within."""
    low, high = tl.load(lens + which), tl.load(lens + which + 1)
    return tl.minimum(tl.maximum(value, low), high), (value >= low) & (value <= high)


@triton.jit
def rows(lens, z, tx, ty, axes):  # type: ignore[no-untyped-def]
    """Return the rows of J V, pixels, and by how much they were made smaller; V: axes in the camera's frame."""
    first = times(minus(axes[0], times(axes[2], tx)), tl.load(lens + FOCAL) / z)
    second = times(minus(axes[1], times(axes[2], ty)), tl.load(lens + FOCAL + 1) / z)
    spread = tl.sqrt(tl.maximum(dot(first, first), dot(second, second)))
    shrink = tl.where(spread > _MOST_SPREAD_PX, _MOST_SPREAD_PX / spread, 1.0)
    return times(first, shrink), times(second, shrink), shrink


@triton.jit
def covariance(lens, first, second):  # type: ignore[no-untyped-def]
    """Return the image's variances xx and yy with the low pass, the covariance, both determinants, and the normal."""
    low = tl.load(lens + LOW_PASS)
    a, b, c = dot(first, first), dot(first, second), dot(second, second)
    normal = cross(first, second)
    area = dot(normal, normal)  # Cauchy-Binet: a c - b^2 without cancellation
    return a + low, b, c + low, area, area + low * (a + c + low), normal


@triton.jit
def logistic(x):  # type: ignore[no-untyped-def]
    """Return 1 / (1 + e^-x)."""
    return 1 / (1 + tl.exp(-x))
