"""The way back through projecting on GPUs, a Gaussian a thread: from sums over pixels to the parameters.

The chain rule backwards through splat_shape.py and splat_colour.py; names there are names here, derivatives have d_.
"""

import triton
import triton.language as tl

from nerf.kernels.triton import splat_colour as colour
from nerf.kernels.triton import splat_project as record
from nerf.kernels.triton import splat_shape as shape
from nerf.kernels.triton import splat_unblend as of

_LEAST_DET = tl.constexpr(record.LEAST_DET.value)


@triton.jit
def unproject(  # type: ignore[no-untyped-def]
    index, means_m, log_scales, rotations, opacities, harmonics, lens, count, stored, records, sums,
    d_means, d_scales, d_rotations, d_opacities, d_harmonics, screen, twists,
    COMPENSATE: tl.constexpr, USED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill the derivatives of the Gaussians index (count,), and twists (programs, 6), sums of each program's."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = k < count
    i = tl.load(index + k, mask=here, other=0)
    own = sums + of.SUMS * k
    p, away = shape.place(means_m, lens, i, here)
    z = tl.where(here, p[2], 1.0)
    q, inverse = shape.quaternion(rotations, i, here)
    s, free = shape.scales(log_scales, i, here)
    axes = shape.scaled(shape.turned(lens, q), s)
    x, y = p[0] / z, p[1] / z
    tx, x_free = shape.held(x, lens, shape.REACH_X)
    ty, y_free = shape.held(y, lens, shape.REACH_Y)
    row0, row1, shrink = shape.rows(lens, z, tx, ty, axes)
    d_x, d_y, d_row0, d_row1 = _image(lens, own, here, row0, row1, COMPENSATE)
    fx, fy = tl.load(lens + shape.FOCAL) / z, tl.load(lens + shape.FOCAL + 1) / z
    # rows: (V0 - tx V2) fx / z and (V1 - ty V2) fy / z, made smaller
    d_z = -(shape.dot(d_row0, row0) + shape.dot(d_row1, row1)) / z
    d_v0, d_v1 = shape.times(d_row0, fx * shrink), shape.times(d_row1, fy * shrink)
    d_v2 = shape.plus(shape.times(d_v0, -tx), shape.times(d_v1, -ty))
    d_axes = d_v0, d_v1, d_v2
    # slopes x / z and y / z: of the shape where they are not held, and of the mean in the image
    d_tx = d_x * fx + tl.where(x_free, -shape.dot(d_v0, axes[2]), 0.0) / z
    d_ty = d_y * fy + tl.where(y_free, -shape.dot(d_v1, axes[2]), 0.0) / z
    d_z -= d_tx * x + d_ty * y
    d_z += tl.where(z <= tl.load(lens + shape.CAP), _sum(own, of.D_DEPTH, here), 0.0)
    d_p = d_tx, d_ty, d_z
    d_away = _colour(harmonics, 3 * stored * i, away, records, own, k, here, d_harmonics, USED)
    right, down, ahead = shape.axis(lens, shape.RIGHT), shape.axis(lens, shape.DOWN), shape.axis(lens, shape.AHEAD)
    d_mean = shape.plus(shape.times(right, d_tx), shape.plus(shape.times(down, d_ty), shape.times(ahead, d_z)))
    shape.store_three(d_means, 3 * k, shape.plus(d_mean, d_away), here)
    _store_scales(d_scales, 3 * k, axes, d_axes, free, here)
    _store_turn(d_rotations, 4 * k, q, inverse, _columns(right, down, ahead, shape.scaled(d_axes, s)), here)
    through = 1 - shape.logistic(tl.load(opacities + i, mask=here, other=0.0))
    tl.store(d_opacities + k, _sum(own, of.G, here) * through, mask=here)
    tl.store(screen + k, tl.sqrt(d_x * d_x + d_y * d_y), mask=here)
    seen = shape.dot(right, d_away), shape.dot(down, d_away), shape.dot(ahead, d_away)
    turn = shape.plus(_crossed(axes, d_axes, 0), shape.plus(_crossed(axes, d_axes, 1), _crossed(axes, d_axes, 2)))
    _store_twist(twists, shape.plus(d_p, seen), shape.plus(shape.cross(p, d_p), turn), here)


@triton.jit
def _sum(own, which, here):  # type: ignore[no-untyped-def]
    return tl.load(own + which, mask=here, other=0.0)


@triton.jit
def _image(lens, own, here, row0, row1, COMPENSATE: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the derivatives by the mean's place in the image and by the rows of J V."""
    a, b, c, area, det, normal = shape.covariance(lens, row0, row1)
    det = tl.where(det >= _LEAST_DET, det, 1.0)
    ca, cb, cc = c / det, -b / det, a / det  # the conic
    gx, gy = _sum(own, of.GX, here), _sum(own, of.GY, here)
    d_ca, d_cb = -0.5 * _sum(own, of.GXX, here), -0.5 * _sum(own, of.GXY, here)
    d_cc = -0.5 * _sum(own, of.GYY, here)
    # conic (J V) by triple products: row0 |row1|^2 - row1 (row0 . row1) would cancel in a needle
    low, by0, by1 = tl.load(lens + shape.LOW_PASS), shape.cross(row1, normal), shape.cross(normal, row0)
    flat0 = shape.divided(shape.plus(by0, shape.times(row0, low)), det)
    flat1 = shape.divided(shape.plus(by1, shape.times(row1, low)), det)
    # d_(J V) = -2 conic d_conic conic (J V)
    inner0 = shape.plus(shape.times(flat0, d_ca), shape.times(flat1, d_cb))
    inner1 = shape.plus(shape.times(flat0, d_cb), shape.times(flat1, d_cc))
    d_row0 = shape.times(shape.plus(shape.times(inner0, ca), shape.times(inner1, cb)), -2.0)
    d_row1 = shape.times(shape.plus(shape.times(inner0, cb), shape.times(inner1, cc)), -2.0)
    if COMPENSATE:  # the opacity's factor sqrt(area / det)
        some, logit = tl.where(area >= _LEAST_DET, area, _LEAST_DET), _sum(own, of.G, here)
        d_row0 = shape.plus(d_row0, shape.times(shape.minus(shape.divided(by0, some), flat0), logit))
        d_row1 = shape.plus(d_row1, shape.times(shape.minus(shape.divided(by1, some), flat1), logit))
    return ca * gx + cb * gy, cb * gx + cc * gy, d_row0, d_row1


@triton.jit
def _along(a, b, WHICH: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the product of two matrices' columns."""
    return a[0][WHICH] * b[0][WHICH] + a[1][WHICH] * b[1][WHICH] + a[2][WHICH] * b[2][WHICH]


@triton.jit
def _crossed(a, b, WHICH: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the cross product of two matrices' columns."""
    return shape.cross((a[0][WHICH], a[1][WHICH], a[2][WHICH]), (b[0][WHICH], b[1][WHICH], b[2][WHICH]))


@triton.jit
def _columns(right, down, ahead, d_u):  # type: ignore[no-untyped-def]
    """Return R_cam_world^T d_u, row by row: derivatives by the rotation to the scene's frame."""
    a, b, c = d_u
    return (
        shape.plus(shape.times(a, right[0]), shape.plus(shape.times(b, down[0]), shape.times(c, ahead[0]))),
        shape.plus(shape.times(a, right[1]), shape.plus(shape.times(b, down[1]), shape.times(c, ahead[1]))),
        shape.plus(shape.times(a, right[2]), shape.plus(shape.times(b, down[2]), shape.times(c, ahead[2]))),
    )


@triton.jit
def _store_scales(d_scales, at, axes, d_axes, free, here):  # type: ignore[no-untyped-def]
    """Write the derivatives by the logarithms of the deviations: 0 where one is held to MOST_M."""
    first = tl.where(free[0], _along(axes, d_axes, 0), 0.0)
    second = tl.where(free[1], _along(axes, d_axes, 1), 0.0)
    third = tl.where(free[2], _along(axes, d_axes, 2), 0.0)
    shape.store_three(d_scales, at, (first, second, third), here)


@triton.jit
def _store_turn(d_rotations, at, q, inverse, d, here):  # type: ignore[no-untyped-def]
    """Write the derivatives by quaternions of any length, from those by their rotations."""
    w, x, y, z = q
    a, b, c = d
    d_w = 2 * (x * (c[1] - b[2]) + y * (a[2] - c[0]) + z * (b[0] - a[1]))
    d_x = 2 * (y * (a[1] + b[0]) + z * (a[2] + c[0]) + w * (c[1] - b[2]) - 2 * x * (b[1] + c[2]))
    d_y = 2 * (x * (a[1] + b[0]) + z * (b[2] + c[1]) + w * (a[2] - c[0]) - 2 * y * (a[0] + c[2]))
    d_z = 2 * (x * (a[2] + c[0]) + y * (b[2] + c[1]) + w * (b[0] - a[1]) - 2 * z * (a[0] + b[1]))
    along = w * d_w + x * d_x + y * d_y + z * d_z
    tl.store(d_rotations + at, inverse * (d_w - w * along), mask=here)
    rest = inverse * (d_x - x * along), inverse * (d_y - y * along), inverse * (d_z - z * along)
    shape.store_three(d_rotations, at + 1, rest, here)


@triton.jit
def _colour(  # type: ignore[no-untyped-def]
    harmonics, at, away, records, own, k, here, d_harmonics, USED: tl.constexpr
):
    """Write the derivatives by the harmonics, and return those by where the mean is seen from."""
    unit, inverse = colour.direction(away)
    lit = shape.three(records, record.RECORD * k + record.RED, here)
    given = shape.three(own, of.D_RED, here)
    d_rgb = (
        tl.where(lit[0] >= _LEAST_DET, given[0], 0.0),  # 0 where the colour is held at 0
        tl.where(lit[1] >= _LEAST_DET, given[1], 0.0),
        tl.where(lit[2] >= _LEAST_DET, given[2], 0.0),
    )
    d_unit = colour.unshade(harmonics, at, unit, d_rgb, here, d_harmonics, 3 * USED * k, USED)
    return shape.times(shape.minus(d_unit, shape.times(unit, shape.dot(unit, d_unit))), inverse)


@triton.jit
def _store_twist(twists, push, turn, here):  # type: ignore[no-untyped-def]
    """Write the sums over a program of the derivatives by a motion and by a turn of the scene."""
    at = twists + 6 * tl.program_id(0)
    tl.store(at, tl.sum(tl.where(here, push[0], 0.0), axis=0))
    tl.store(at + 1, tl.sum(tl.where(here, push[1], 0.0), axis=0))
    tl.store(at + 2, tl.sum(tl.where(here, push[2], 0.0), axis=0))
    tl.store(at + 3, tl.sum(tl.where(here, turn[0], 0.0), axis=0))
    tl.store(at + 4, tl.sum(tl.where(here, turn[1], 0.0), axis=0))
    tl.store(at + 5, tl.sum(tl.where(here, turn[2], 0.0), axis=0))
