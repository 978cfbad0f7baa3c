"""Colours of Gaussians from where they are seen, compiled, one at a time. Equals nerf/twin/splat.py, `colours`."""

import numpy as np

from priors.machine.compiled import FAST, compiled

# nerf.harmonics: real orthonormal harmonics of degrees 0 to 3.
Y0, Y1 = np.float32(0.28209479177387814), np.float32(0.48860251190291987)
Y2 = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)
Y3 = (
    np.float32(0.5900435899266435),
    np.float32(2.890611442640554),
    np.float32(0.4570457994644658),
    np.float32(0.3731763325901154),
    np.float32(1.445305721320277),
)


@compiled(fastmath=FAST)
def fill_basis(x, y, z, used, basis):  # type: ignore[no-untyped-def]
    """Set the first `used` harmonics of a unit direction."""
    basis[0] = Y0
    if used > 1:
        basis[1], basis[2], basis[3] = -Y1 * y, Y1 * z, -Y1 * x
    if used > 4:
        xx, yy, zz = x * x, y * y, z * z
        basis[4], basis[5], basis[7] = Y2[0] * x * y, -Y2[0] * y * z, -Y2[0] * x * z
        basis[6], basis[8] = Y2[1] * (3 * zz - 1), Y2[2] * (xx - yy)
        if used > 9:
            basis[9], basis[15] = -Y3[0] * y * (3 * xx - yy), -Y3[0] * x * (xx - 3 * yy)
            basis[10], basis[14] = Y3[1] * x * y * z, Y3[4] * z * (xx - yy)
            basis[11], basis[13] = -Y3[2] * y * (5 * zz - 1), -Y3[2] * x * (5 * zz - 1)
            basis[12] = Y3[3] * z * (5 * zz - 3)


@compiled(fastmath=FAST)
def slope(x, y, z, used, g, out):  # type: ignore[no-untyped-def]
    """Set out (3,) to the derivative of sum_k g_k Y_k by the direction's parts, each on its own."""
    out[0], out[1], out[2] = -Y1 * g[3], -Y1 * g[1], Y1 * g[2]
    if used > 4:
        out[0] += Y2[0] * (y * g[4] - z * g[7]) + 2 * Y2[2] * x * g[8]
        out[1] += Y2[0] * (x * g[4] - z * g[5]) - 2 * Y2[2] * y * g[8]
        out[2] += -Y2[0] * (y * g[5] + x * g[7]) + 6 * Y2[1] * z * g[6]
    if used > 9:
        xx, yy, zz = x * x, y * y, z * z
        out[0] += -6 * Y3[0] * x * y * g[9] + Y3[1] * y * z * g[10] - Y3[2] * (5 * zz - 1) * g[13]
        out[0] += 2 * Y3[4] * x * z * g[14] - 3 * Y3[0] * (xx - yy) * g[15]
        out[1] += -3 * Y3[0] * (xx - yy) * g[9] + Y3[1] * x * z * g[10] - Y3[2] * (5 * zz - 1) * g[11]
        out[1] += -2 * Y3[4] * y * z * g[14] + 6 * Y3[0] * x * y * g[15]
        out[2] += Y3[1] * x * y * g[10] - 10 * Y3[2] * z * (y * g[11] + x * g[13])
        out[2] += Y3[3] * (15 * zz - 3) * g[12] + Y3[4] * (xx - yy) * g[14]


@compiled(fastmath=FAST)
def shade(harmonics, i, count, used, direction, basis):  # type: ignore[no-untyped-def]
    """Return the colour of Gaussian i, red, green, blue, from a direction of any length; fills basis."""
    half, zero = np.float32(0.5), np.float32(0)
    if used > 1:
        x, y, z = direction
        length = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))
        fill_basis(x / length, y / length, z / length, used, basis)
    else:
        basis[0] = Y0
    red, green, blue = half, half, half
    start = np.uint64(i) * np.uint64(3 * count)
    for k in range(np.uint64(used)):
        at = start + np.uint64(3) * k
        red += basis[k] * harmonics[at]
        green += basis[k] * harmonics[at + np.uint64(1)]
        blue += basis[k] * harmonics[at + np.uint64(2)]
    return max(red, zero), max(green, zero), max(blue, zero)
