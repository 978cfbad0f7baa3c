"""A Gaussian's shape in the image, compiled, sixteen at a time: what projecting and its way back both need.

Equals nerf/twin/splat.py, `project`. Vectors and matrices are tuples of lanes, row by row.
"""

import math

import numpy as np

from nerf.gaussians.types import LEAST_TURN, MOST_M, MOST_SPREAD_PX
from nerf.kernels.cpu.lanes import exponential, floats, fma, from_bits, gather, ints, larger, root, smaller
from nerf.kernels.cpu.splat_lanes import kept, picked
from priors.machine.compiled import compiled

LOG_MOST_M = math.log(MOST_M)


@compiled
def pick(array, columns, column, i):  # type: ignore[no-untyped-def]
    """Return one column of rows i (lanes) of a flat float32 array."""
    return from_bits(gather(array, np.int64(column), i * ints(np.int32(columns))))


@compiled
def dot(a, b):  # type: ignore[no-untyped-def]
    """Return the product of two vectors."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@compiled
def cross(a, b):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def times(a, scale):  # type: ignore[no-untyped-def]
    """Return a vector times a number."""
    return a[0] * scale, a[1] * scale, a[2] * scale


@compiled
def plus(a, b):  # type: ignore[no-untyped-def]
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a, b):  # type: ignore[no-untyped-def]
    """Return the difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def divided(a, number):  # type: ignore[no-untyped-def]
    """Return a vector divided by a number."""
    return a[0] / number, a[1] / number, a[2] / number


@compiled
def constants(vector):  # type: ignore[no-untyped-def]
    """Return three numbers, each in all lanes."""
    return floats(vector[0]), floats(vector[1]), floats(vector[2])


@compiled
def place(means_m, lens, i):  # type: ignore[no-untyped-def]
    """Return where means are in the camera's frame, metres, and whence they are seen: mean less centre."""
    c = lens.centre_m
    away = (
        pick(means_m, 3, 0, i) - floats(c[0]),
        pick(means_m, 3, 1, i) - floats(c[1]),
        pick(means_m, 3, 2, i) - floats(c[2]),
    )
    p = dot(constants(lens.right), away), dot(constants(lens.down), away), dot(constants(lens.ahead), away)
    return p, away


@compiled
def quaternion(rotations, i):  # type: ignore[no-untyped-def]
    """Return unit quaternions (w, x, y, z) and what they were divided by, inverted: 0 for those that are none."""
    w, x, y, z = pick(rotations, 4, 0, i), pick(rotations, 4, 1, i), pick(rotations, 4, 2, i), pick(rotations, 4, 3, i)
    one, tiny = floats(np.float32(1)), floats(np.float32(LEAST_TURN))
    longest = larger(tiny, larger(larger(_size(w), _size(x)), larger(_size(y), _size(z))))
    shorter = one / longest  # float32 holds no square of 1e20
    w, x, y, z = w * shorter, x * shorter, y * shorter, z * shorter
    squared = fma(w, w, fma(x, x, fma(y, y, z * z)))
    usable = kept(squared * longest * longest, tiny, one / root(picked(squared, tiny, squared, tiny)))
    return (w * usable, x * usable, y * usable, z * usable), shorter * usable


@compiled
def _size(x):  # type: ignore[no-untyped-def]
    return larger(x, floats(np.float32(0)) - x)


@compiled
def turned(lens, q):  # type: ignore[no-untyped-def]
    """Return the Gaussian's unit axes in the camera's frame, (3, 3), an axis a column."""
    w, x, y, z = q
    one, two = floats(np.float32(1)), floats(np.float32(2))
    first = one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)  # columns in the scene's frame
    second = two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)
    third = two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)
    right, down, ahead = constants(lens.right), constants(lens.down), constants(lens.ahead)
    return (
        (dot(right, first), dot(right, second), dot(right, third)),
        (dot(down, first), dot(down, second), dot(down, third)),
        (dot(ahead, first), dot(ahead, second), dot(ahead, third)),
    )


@compiled
def scales(log_scales, i):  # type: ignore[no-untyped-def]
    """Return the standard deviations along the axes, metres, held to MOST_M; NaN stays NaN."""
    most = floats(np.float32(LOG_MOST_M))
    a, b, c = pick(log_scales, 3, 0, i), pick(log_scales, 3, 1, i), pick(log_scales, 3, 2, i)
    return exponential(smaller(most, a)), exponential(smaller(most, b)), exponential(smaller(most, c))


@compiled
def unheld(log_scales, i, d):  # type: ignore[no-untyped-def]
    """Return the derivatives by the logarithms of the deviations: 0 where one is held to MOST_M."""
    most = floats(np.float32(LOG_MOST_M))
    a, b, c = pick(log_scales, 3, 0, i), pick(log_scales, 3, 1, i), pick(log_scales, 3, 2, i)
    return kept(most, a, d[0]), kept(most, b, d[1]), kept(most, c, d[2])


@compiled
def scaled(u, s):  # type: ignore[no-untyped-def]
    """Return a matrix whose columns are multiplied by numbers."""
    a, b, c = u
    return (
        (a[0] * s[0], a[1] * s[1], a[2] * s[2]),
        (b[0] * s[0], b[1] * s[1], b[2] * s[2]),
        (c[0] * s[0], c[1] * s[1], c[2] * s[2]),
    )


@compiled
def slopes(lens, p):  # type: ignore[no-untyped-def]
    """Return x / z and y / z held to where a shape is taken, and both as they are."""
    x, y = p[0] / p[2], p[1] / p[2]
    tx = smaller(larger(x, floats(lens.reach_x[0])), floats(lens.reach_x[1]))
    ty = smaller(larger(y, floats(lens.reach_y[0])), floats(lens.reach_y[1]))
    return tx, ty, x, y


@compiled
def rows(lens, z, tx, ty, axes):  # type: ignore[no-untyped-def]
    """Return the rows of J V, pixels, and by how much they were made smaller; V: axes in the camera's frame."""
    fx, fy = floats(lens.focal[0]) / z, floats(lens.focal[1]) / z
    a, b, c = axes
    first = (a[0] - tx * c[0]) * fx, (a[1] - tx * c[1]) * fx, (a[2] - tx * c[2]) * fx
    second = (b[0] - ty * c[0]) * fy, (b[1] - ty * c[1]) * fy, (b[2] - ty * c[2]) * fy
    spread = root(larger(dot(first, first), dot(second, second)))
    shrink = smaller(floats(np.float32(MOST_SPREAD_PX)) / spread, floats(np.float32(1)))
    return times(first, shrink), times(second, shrink), shrink


@compiled
def covariance(lens, first, second):  # type: ignore[no-untyped-def]
    """Return the image's variances xx and yy with the low pass, the covariance, both determinants, and the normal."""
    low = floats(lens.low_pass_px2)
    a, b, c = dot(first, first), dot(first, second), dot(second, second)
    normal = cross(first, second)
    area = dot(normal, normal)  # Cauchy-Binet: a c - b^2 without cancellation
    return a + low, b, c + low, area, fma(low, a + c + low, area), normal


@compiled
def logistic(x):  # type: ignore[no-untyped-def]
    """Return 1 / (1 + e^-x)."""
    one = floats(np.float32(1))
    return one / (one + exponential(floats(np.float32(0)) - x))
