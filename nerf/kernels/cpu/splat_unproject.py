"""The way back through projecting, compiled, sixteen Gaussians at a time: from sums over pixels to the parameters.

The chain rule backwards through splat_shape.py and splat_colour.py; names there are names here, derivatives have d_.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import floats, fma, ints, load_floats, load_ints, root, store, transpose
from nerf.kernels.cpu.splat_colour import direction, unshade, zero
from nerf.kernels.cpu.splat_lanes import kept, lanes, picked, store_some
from nerf.kernels.cpu.splat_project import CHUNK, LEAST_DET, RECORD, RED, Lists, Numbers, Scene, View
from nerf.kernels.cpu.splat_shape import (
    constants,
    covariance,
    cross,
    divided,
    dot,
    logistic,
    minus,
    pick,
    place,
    plus,
    quaternion,
    rows,
    scaled,
    scales,
    slopes,
    times,
    turned,
    unheld,
)
from nerf.kernels.cpu.splat_unblend import D_DEPTH, D_RED, GX, GXX, GXY, GY, GYY, G
from nerf.kernels.lens import Lens
from priors.machine.compiled import compiled


class Derivatives(NamedTuple):
    """A loss's derivatives by the parameters of the v Gaussians in view, flat; filled in place."""

    means_m: Numbers
    log_scales: Numbers
    rotations: Numbers
    opacities: Numbers
    harmonics: Numbers
    screen: Numbers
    twists: npt.NDArray[np.float64]
    """(chunks * 6,)"""


OUT = 512
"""Where the words hold the parameters' derivatives, a lane a Gaussian; before them the sums."""
MEAN, SCALE, TURN, LOGIT, SCREEN, TWIST = 0, 3, 6, 10, 11, 12
"""Which is where."""


@compiled
def unproject(
    scene: Scene, lens: Lens, view: View, lists: Lists, parts: Numbers, out: Derivatives, first: int, last: int
) -> None:
    """Set the derivatives of chunks first to last - 1."""
    words, which = np.empty(OUT + 32 * 16, np.float32), np.empty(16, np.int32)
    room, twist = np.empty(512 + 48 * 16, np.float32), np.empty(6 * 16, np.float32)
    for chunk in range(first, last):
        start, found = lists.first_index[chunk], view.found[chunk]
        for axis in range(6):
            store(twist, np.int64(16 * axis), zero())
        for k in range(0, found, 16):
            count, row = min(16, found - k), chunk * CHUNK + k
            for lane in range(16):
                which[np.uint64(lane)] = view.gaussian[np.uint64(row + min(lane, count - 1))]
            _gather(lists, parts, words, start + k, count)
            _sixteen(scene, lens, words, which)
            _colour(scene, lens, view.records, row, words, room, which)
            for axis in range(6):
                step = load_floats(words, np.int64(OUT + 16 * (TWIST + axis)))
                store(twist, np.int64(16 * axis), load_floats(twist, np.int64(16 * axis)) + step)
            _scatter(out, words, start + k, count)
            _scatter_harmonics(out.harmonics, room, scene.used, start + k, count)
        for axis in range(6):
            total = 0.0
            for lane in range(16):
                total += twist[16 * axis + lane]
            out.twists[6 * chunk + axis] = total


@compiled
def _gather(lists, parts, words, start, count):  # type: ignore[no-untyped-def]
    """Add up the copies of 16 Gaussians, a sum a row and a Gaussian a lane; lanes from count on are 0."""
    for lane in range(16):
        total = floats(np.float32(0))
        if lane < count:
            for copy in range(lists.copies[start + lane], lists.copies[start + lane + 1]):
                total = total + load_floats(parts, np.int64(RECORD) * copy)
        store(words, np.int64(256 + 16 * lane), total)
    transpose(words, np.int64(256), np.int64(0))


@compiled
def _sum(words, k):  # type: ignore[no-untyped-def]
    return load_floats(words, np.int64(16 * k))


@compiled
def _store_three(words, k, vector):  # type: ignore[no-untyped-def]
    store(words, np.int64(OUT + 16 * k), vector[0])
    store(words, np.int64(OUT + 16 * k + 16), vector[1])
    store(words, np.int64(OUT + 16 * k + 32), vector[2])


@compiled
def _sixteen(scene, lens, words, which):  # type: ignore[no-untyped-def]
    """Write the derivatives of 16 Gaussians: mean (3), log scales (3), quaternion (4), logit, screen, twist (6)."""
    i, none, one = load_ints(which, np.int64(0)), zero(), floats(np.float32(1))
    p, _ = place(scene.means_m, lens, i)
    q, inverse = quaternion(scene.rotations, i)
    s = scales(scene.log_scales, i)
    axes = scaled(turned(lens, q), s)
    tx, ty, x, y = slopes(lens, p)
    row0, row1, shrink = rows(lens, p[2], tx, ty, axes)
    d_x, d_y, d_row0, d_row1 = _image(lens, words, row0, row1)
    fx, fy = floats(lens.focal[0]) / p[2], floats(lens.focal[1]) / p[2]
    # rows: (V0 - tx V2) fx / z and (V1 - ty V2) fy / z, made smaller
    d_z = none - (dot(d_row0, row0) + dot(d_row1, row1)) / p[2]
    d_v0, d_v1 = times(d_row0, fx * shrink), times(d_row1, fy * shrink)
    d_v2 = plus(times(d_v0, none - tx), times(d_v1, none - ty))
    d_axes = d_v0, d_v1, d_v2
    # slopes x / z and y / z: of the shape where they are not held, and of the mean in the image
    d_tx = fma(d_x, fx, _between(x, lens.reach_x, none - dot(d_v0, axes[2])) / p[2])
    d_ty = fma(d_y, fy, _between(y, lens.reach_y, none - dot(d_v1, axes[2])) / p[2])
    d_z = d_z - fma(d_tx, x, d_ty * y) + kept(floats(lens.cap_m), p[2], _sum(words, D_DEPTH))
    d_p = d_tx, d_ty, d_z
    right, down, ahead = constants(lens.right), constants(lens.down), constants(lens.ahead)
    _store_three(words, MEAN, plus(times(right, d_tx), plus(times(down, d_ty), times(ahead, d_z))))
    d_scales = _along(axes, d_axes, 0), _along(axes, d_axes, 1), _along(axes, d_axes, 2)
    _store_three(words, SCALE, unheld(scene.log_scales, i, d_scales))
    d_q = _turn(q, _columns(right, down, ahead, scaled(d_axes, s)))
    along = fma(q[0], d_q[0], fma(q[1], d_q[1], fma(q[2], d_q[2], q[3] * d_q[3])))
    store(words, np.int64(OUT + 16 * TURN), inverse * (d_q[0] - q[0] * along))
    rest = inverse * (d_q[1] - q[1] * along), inverse * (d_q[2] - q[2] * along), inverse * (d_q[3] - q[3] * along)
    _store_three(words, TURN + 1, rest)
    store(words, np.int64(OUT + 16 * LOGIT), _sum(words, G) * (one - logistic(pick(scene.opacities, 1, 0, i))))
    store(words, np.int64(OUT + 16 * SCREEN), root(fma(d_x, d_x, d_y * d_y)))
    _store_three(words, TWIST, d_p)
    turn = plus(_crossed(axes, d_axes, 0), plus(_crossed(axes, d_axes, 1), _crossed(axes, d_axes, 2)))
    _store_three(words, TWIST + 3, plus(cross(p, d_p), turn))


@compiled
def _image(lens, words, row0, row1):  # type: ignore[no-untyped-def]
    """Return the derivatives by the mean's place in the image and by the rows of J V."""
    half, minus_two, none = floats(np.float32(0.5)), floats(np.float32(-2)), zero()
    a, b, c, area, det, normal = covariance(lens, row0, row1)
    ca, cb, cc = c / det, none - b / det, a / det  # the conic
    gx, gy, logit = _sum(words, GX), _sum(words, GY), _sum(words, G)
    d_ca, d_cb, d_cc = none - half * _sum(words, GXX), none - half * _sum(words, GXY), none - half * _sum(words, GYY)
    # conic (J V) by triple products: row0 |row1|^2 - row1 (row0 . row1) would cancel in a needle
    low, by0, by1 = floats(lens.low_pass_px2), cross(row1, normal), cross(normal, row0)
    flat0, flat1 = divided(plus(by0, times(row0, low)), det), divided(plus(by1, times(row1, low)), det)
    # d_(J V) = -2 conic d_conic conic (J V)
    inner0, inner1 = plus(times(flat0, d_ca), times(flat1, d_cb)), plus(times(flat0, d_cb), times(flat1, d_cc))
    d_row0 = times(plus(times(inner0, ca), times(inner1, cb)), minus_two)
    d_row1 = times(plus(times(inner0, cb), times(inner1, cc)), minus_two)
    if lens.compensate:  # the opacity's factor sqrt(area / det)
        least = floats(np.float32(LEAST_DET))
        some = picked(area, least, area, least)
        d_row0 = plus(d_row0, times(minus(divided(by0, some), flat0), logit))
        d_row1 = plus(d_row1, times(minus(divided(by1, some), flat1), logit))
    return fma(ca, gx, cb * gy), fma(cb, gx, cc * gy), d_row0, d_row1


@compiled
def _between(x, reach, value):  # type: ignore[no-untyped-def]
    """Return values where x lies within reach, else 0."""
    return kept(x, floats(reach[0]), kept(floats(reach[1]), x, value))


@compiled
def _along(a, b, column):  # type: ignore[no-untyped-def]
    """Return the product of two matrices' columns."""
    return fma(a[0][column], b[0][column], fma(a[1][column], b[1][column], a[2][column] * b[2][column]))


@compiled
def _crossed(a, b, column):  # type: ignore[no-untyped-def]
    """Return the cross product of two matrices' columns."""
    return cross((a[0][column], a[1][column], a[2][column]), (b[0][column], b[1][column], b[2][column]))


@compiled
def _columns(right, down, ahead, d_u):  # type: ignore[no-untyped-def]
    """Return R_cam_world^T d_u, row by row: derivatives by the rotation to the scene's frame."""
    a, b, c = d_u
    return (
        plus(times(a, right[0]), plus(times(b, down[0]), times(c, ahead[0]))),
        plus(times(a, right[1]), plus(times(b, down[1]), times(c, ahead[1]))),
        plus(times(a, right[2]), plus(times(b, down[2]), times(c, ahead[2]))),
    )


@compiled
def _turn(q, d):  # type: ignore[no-untyped-def]
    """Return the derivatives by a unit quaternion's parts, each on its own, from those by its rotation."""
    w, x, y, z = q
    two = floats(np.float32(2))
    a, b, c = d
    d_w = x * (c[1] - b[2]) + y * (a[2] - c[0]) + z * (b[0] - a[1])
    d_x = y * (a[1] + b[0]) + z * (a[2] + c[0]) + w * (c[1] - b[2]) - two * x * (b[1] + c[2])
    d_y = x * (a[1] + b[0]) + z * (b[2] + c[1]) + w * (a[2] - c[0]) - two * y * (a[0] + c[2])
    d_z = x * (a[2] + c[0]) + y * (b[2] + c[1]) + w * (b[0] - a[1]) - two * z * (a[0] + b[1])
    return two * d_w, two * d_x, two * d_y, two * d_z


@compiled
def _colour(scene, lens, records, row, words, room, which):  # type: ignore[no-untyped-def]
    """Fill room with the derivatives of 16 Gaussians' harmonics; add those by their directions to mean and twist.

    row: of the view, the first of them.
    """
    i, lane = load_ints(which, np.int64(0)), lanes() + ints(np.int32(row))
    d_rgb = (_lit(records, lane, words, 0), _lit(records, lane, words, 1), _lit(records, lane, words, 2))
    unit, inverse = (zero(), zero(), zero()), zero()
    if scene.used > 1:
        _, away = place(scene.means_m, lens, i)
        unit, inverse = direction(away)
    d_unit = unshade(scene.harmonics, scene.stored, scene.used, i, unit, d_rgb, room[:512], room[512:])
    if scene.used == 1:
        return
    d_away = times(minus(d_unit, times(unit, dot(unit, d_unit))), inverse)
    frame = constants(lens.right), constants(lens.down), constants(lens.ahead)
    for axis in range(3):
        at = np.int64(OUT + 16 * (MEAN + axis))
        store(words, at, load_floats(words, at) + d_away[axis])
        at = np.int64(OUT + 16 * (TWIST + axis))
        store(words, at, load_floats(words, at) + dot(frame[axis], d_away))


@compiled
def _lit(records, row, words, c):  # type: ignore[no-untyped-def]
    """Return the derivatives by a channel's sum: 0 where the colour is held at 0."""
    colour = pick(records, RECORD, RED + c, row)
    return kept(colour, floats(np.float32(LEAST_DET)), _sum(words, D_RED + c))


@compiled
def _scatter(out, words, at, count):  # type: ignore[no-untyped-def]
    """Write the derivatives of `count` Gaussians from place `at` on, all but the harmonics'."""
    transpose(words, np.int64(OUT), np.int64(0))
    for lane in range(count):
        row, place = 16 * lane, at + lane
        store_some(out.means_m, 3 * place, np.int64(3), load_floats(words, np.int64(row + MEAN)))
        store_some(out.log_scales, 3 * place, np.int64(3), load_floats(words, np.int64(row + SCALE)))
        store_some(out.rotations, 4 * place, np.int64(4), load_floats(words, np.int64(row + TURN)))
        out.opacities[np.uint64(place)] = words[np.uint64(row + LOGIT)]
        out.screen[np.uint64(place)] = words[np.uint64(row + SCREEN)]


@compiled
def _scatter_harmonics(out, room, used, at, count):  # type: ignore[no-untyped-def]
    """Write the derivatives by the harmonics of `count` Gaussians from place `at` on."""
    for block in range(0, 3 * used, 16):
        transpose(room, np.int64(512 + 16 * block), np.int64(0))
        for lane in range(count):
            start = np.int64(3 * used) * (at + lane) + block
            store_some(out, start, np.int64(min(16, 3 * used - block)), load_floats(room, np.int64(16 * lane)))
