"""Colours of Gaussians from where they are seen, compiled, sixteen at a time. Equals nerf/twin/splat.py, `colours`."""

import numpy as np

from nerf.kernels.cpu.lanes import floats, fma, larger, load_floats, root, store
from nerf.kernels.cpu.splat_shape import dot, pick, times
from priors.machine.compiled import compiled

# nerf.harmonics: real orthonormal harmonics of degrees 0 to 3.
Y0, Y1 = np.float32(0.28209479177387814), np.float32(0.48860251190291987)
Y20, Y21, Y22 = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)
Y30, Y31, Y32 = np.float32(0.5900435899266435), np.float32(2.890611442640554), np.float32(0.4570457994644658)
Y33, Y34 = np.float32(0.3731763325901154), np.float32(1.445305721320277)
LEAST_M = np.float32(1e-12)
"""What is seen from nearer has no direction."""


@compiled
def _put(words, k, value):  # type: ignore[no-untyped-def]
    store(words, np.int64(16 * k), value)


@compiled
def _get(words, k):  # type: ignore[no-untyped-def]
    return load_floats(words, np.int64(16 * k))


@compiled
def direction(away):  # type: ignore[no-untyped-def]
    """Return unit directions, and 1 / length."""
    inverse = floats(np.float32(1)) / larger(root(dot(away, away)), floats(LEAST_M))
    return times(away, inverse), inverse


@compiled
def fill_basis(unit, used, words):  # type: ignore[no-untyped-def]
    """Set the first `used` harmonics of unit directions: a harmonic 16 words."""
    x, y, z = unit
    _put(words, 0, floats(Y0))
    if used > 1:
        _put(words, 1, floats(-Y1) * y)
        _put(words, 2, floats(Y1) * z)
        _put(words, 3, floats(-Y1) * x)
    if used > 4:
        xx, yy, zz, one = x * x, y * y, z * z, floats(np.float32(1))
        _put(words, 4, floats(Y20) * x * y)
        _put(words, 5, floats(-Y20) * y * z)
        _put(words, 6, floats(Y21) * fma(floats(np.float32(3)), zz, zero() - one))
        _put(words, 7, floats(-Y20) * x * z)
        _put(words, 8, floats(Y22) * (xx - yy))
        if used > 9:
            three, five = floats(np.float32(3)), floats(np.float32(5))
            _put(words, 9, floats(-Y30) * y * (three * xx - yy))
            _put(words, 10, floats(Y31) * x * y * z)
            _put(words, 11, floats(-Y32) * y * (five * zz - one))
            _put(words, 12, floats(Y33) * z * (five * zz - three))
            _put(words, 13, floats(-Y32) * x * (five * zz - one))
            _put(words, 14, floats(Y34) * z * (xx - yy))
            _put(words, 15, floats(-Y30) * x * (xx - three * yy))


@compiled
def zero():  # type: ignore[no-untyped-def]
    """Return 0 in all lanes."""
    return floats(np.float32(0))


@compiled
def slope(unit, used, g):  # type: ignore[no-untyped-def]
    """Return the derivative of sum_k g_k Y_k by the direction's parts, each on its own; g: 16 words a harmonic."""
    x, y, z = unit
    d_x, d_y, d_z = floats(-Y1) * _get(g, 3), floats(-Y1) * _get(g, 1), floats(Y1) * _get(g, 2)
    if used > 4:
        a, b, c = _get(g, 4), _get(g, 5), _get(g, 7)
        double = floats(np.float32(2) * Y22) * _get(g, 8)
        d_x = d_x + floats(Y20) * (y * a - z * c) + double * x
        d_y = d_y + floats(Y20) * (x * a - z * b) - double * y
        d_z = d_z - floats(Y20) * (y * b + x * c) + floats(np.float32(6) * Y21) * z * _get(g, 6)
    if used > 9:
        xx, yy, zz, one = x * x, y * y, z * z, floats(np.float32(1))
        first, last = floats(Y30) * _get(g, 9), floats(Y30) * _get(g, 15)
        side, high = floats(Y31) * _get(g, 10), floats(Y34) * _get(g, 14)
        left, right = floats(Y32) * _get(g, 11), floats(Y32) * _get(g, 13)
        three, six, five = floats(np.float32(3)), floats(np.float32(6)), floats(np.float32(5))
        two, flat = floats(np.float32(2)), xx - yy
        ring = five * zz - one
        d_x = d_x - six * x * y * first + y * z * side - ring * right + two * x * z * high - three * flat * last
        d_y = d_y - three * flat * first + x * z * side - ring * left - two * y * z * high + six * x * y * last
        d_z = d_z + x * y * side - floats(np.float32(10)) * z * (y * left + x * right) + flat * high
        d_z = d_z + floats(Y33) * (floats(np.float32(15)) * zz - three) * _get(g, 12)
    return d_x, d_y, d_z


@compiled
def shade(harmonics, stored, used, i, unit, words):  # type: ignore[no-untyped-def]
    """Return the colours of Gaussians i (lanes), red, green, blue, from unit directions; fills the basis."""
    fill_basis(unit, used, words)
    half = floats(np.float32(0.5))
    red, green, blue = half, half, half
    for k in range(used):
        y = _get(words, k)
        red = fma(y, pick(harmonics, 3 * stored, 3 * k, i), red)
        green = fma(y, pick(harmonics, 3 * stored, 3 * k + 1, i), green)
        blue = fma(y, pick(harmonics, 3 * stored, 3 * k + 2, i), blue)
    return larger(zero(), red), larger(zero(), green), larger(zero(), blue)  # in this order NaN stays NaN


@compiled
def unshade(harmonics, stored, used, i, unit, d_rgb, words, out):  # type: ignore[no-untyped-def]
    """Fill out with the derivatives by the coefficients, 16 words each, and return those by the direction's parts.

    words: room for 32 harmonics.
    """
    fill_basis(unit, used, words)
    g = words[256:]
    for k in range(used):
        y, total = _get(words, k), zero()
        for c in range(3):
            _put(out, 3 * k + c, y * d_rgb[c])
            if used > 1:
                total = fma(d_rgb[c], pick(harmonics, 3 * stored, 3 * k + c, i), total)
        _put(g, k, total)
    if used == 1:
        return zero(), zero(), zero()
    return slope(unit, used, g)
