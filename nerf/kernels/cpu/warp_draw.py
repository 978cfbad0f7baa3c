"""Drawing a posed depth map into another view, compiled: which of its surfaces the other view sees, and how far off.

Inverse depth (1/m) everywhere: it is linear over a plane's picture. A pair of views is a matrix (3, 4): A = K' R K^-1
and b = K' t. A pixel (u, v) of inverse depth d lands at (q0, q1) / q2 with q = A (u, v, 1) + b d, and has there the
inverse depth d / q2 (Hartley, Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 9.6).
"""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled

NONE = np.float32(-1)
"""No inverse depth is known."""
SQUARE, ALONE = 1, 2
"""Of a pixel: it forms one surface with those to the right, below, and to the lower right; it ends a surface."""
LEAST_AHEAD = 1e-9
"""What lands with a smaller q2 is behind the other camera."""
ON_EDGE = 1e-6
"""Edges of triangles belong to them: share of the triangle by which a pixel may miss."""
FAR_PX = 1e6
Floats = npt.NDArray[np.float32]
Matrices = npt.NDArray[np.float64]


@compiled(error_model="numpy", inline="always")
def land(M, u, v, inverse):  # type: ignore[no-untyped-def]
    """Return where a pixel lands in the other view, and its inverse depth there: below 0 behind the camera."""
    q2 = M[2, 0] * u + M[2, 1] * v + M[2, 2] + M[2, 3] * inverse
    if not q2 > LEAST_AHEAD:
        return 0.0, 0.0, -1.0
    q0 = M[0, 0] * u + M[0, 1] * v + M[0, 2] + M[0, 3] * inverse
    q1 = M[1, 0] * u + M[1, 1] * v + M[1, 2] + M[1, 3] * inverse
    return q0 / q2, q1 / q2, inverse / q2


@compiled(error_model="numpy")
def draw(inverse: Floats, joins: npt.NDArray[np.uint8], M: Matrices, seen: Floats) -> None:
    """Draw a view's surfaces into another view's inverse depths, in place; the nearest wins.

    Args:
        inverse: (h, w) inverse depth of the view that is drawn, 1/m; NONE where there is none.
        joins: (h, w) SQUARE and ALONE of each pixel.
        M: (3, 4) from this view to the other.
        seen: (height, width) the other view's inverse depths, 1/m; NONE where nothing is seen.
    """
    h, w = inverse.shape
    x, y, d = np.empty((2, w)), np.empty((2, w)), np.full((2, w), -1.0)  # this row and the one above
    for v in range(h):
        now, above = v % 2, (v + 1) % 2
        for u in range(w):
            d[now, u] = -1.0
            if inverse[v, u] >= 0:
                x[now, u], y[now, u], d[now, u] = land(M, float(u), float(v), float(inverse[v, u]))
                if d[now, u] >= 0 and joins[v, u] & ALONE:
                    _pixel(M, float(u), float(v), float(inverse[v, u]), seen)
        if v == 0:
            continue
        for u in range(w - 1):
            if not joins[v - 1, u] & SQUARE:
                continue
            if min(min(d[above, u], d[above, u + 1]), min(d[now, u], d[now, u + 1])) < 0:
                continue
            upper, lower = (x[above, u + 1], y[above, u + 1], d[above, u + 1]), (x[now, u], y[now, u], d[now, u])
            _triangle((x[above, u], y[above, u], d[above, u]), upper, lower, seen)
            _triangle((x[now, u + 1], y[now, u + 1], d[now, u + 1]), upper, lower, seen)


@compiled(error_model="numpy")
def _pixel(M, u, v, inverse, seen):  # type: ignore[no-untyped-def]
    """Draw a pixel of one depth, as large as it looks from the other view."""
    first, last = land(M, u - 0.5, v - 0.5, inverse), land(M, u + 0.5, v + 0.5, inverse)
    upper, lower = land(M, u + 0.5, v - 0.5, inverse), land(M, u - 0.5, v + 0.5, inverse)
    if min(min(first[2], last[2]), min(upper[2], lower[2])) >= 0:
        _triangle(first, upper, lower, seen)
        _triangle(last, upper, lower, seen)


@compiled(error_model="numpy")
def _triangle(a, b, c, seen):  # type: ignore[no-untyped-def]
    """Draw a triangle of corners (x, y, inverse depth): inverse depth is linear between them."""
    height, width = seen.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if area == 0:
        return
    left, right = max(min(a[0], b[0], c[0]), 0.0), min(max(a[0], b[0], c[0]), FAR_PX)
    top, low = max(min(a[1], b[1], c[1]), 0.0), min(max(a[1], b[1], c[1]), FAR_PX)
    if left > FAR_PX or top > FAR_PX or right < 0 or low < 0:
        return
    for row in range(int(np.ceil(top)), min(height - 1, int(low)) + 1):
        for column in range(int(np.ceil(left)), min(width - 1, int(right)) + 1):
            share_b = ((column - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (row - a[1])) / area
            share_c = ((b[0] - a[0]) * (row - a[1]) - (column - a[0]) * (b[1] - a[1])) / area
            if min(share_b, share_c) < -ON_EDGE or share_b + share_c > 1 + ON_EDGE:
                continue
            inverse = a[2] + share_b * (b[2] - a[2]) + share_c * (c[2] - a[2])
            if inverse > seen[row, column]:
                seen[row, column] = inverse
