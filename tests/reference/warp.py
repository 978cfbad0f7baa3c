"""The warp as loops over whole arrays: every triangle asks every pixel, every view votes on every offer."""

import numpy as np

from nerf.kernels.cpu.warp_draw import ALONE, SQUARE


def land(M, u, v, d):
    """Where pixels land in another view, and their inverse depth there; NaN behind the camera."""
    q = M[:, :3] @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1) + M[:, 3:] * np.ravel(d)
    q[:, ~(q[2] > 1e-9)] = np.nan
    return (q[0] / q[2]).reshape(u.shape), (q[1] / q[2]).reshape(u.shape), (np.ravel(d) / q[2]).reshape(u.shape), q[2]


def draw(inverse, joins, M, size):
    """Inverse depths (height, width) that another view sees; -1: nothing."""
    h, w = inverse.shape
    seen = np.full(size, -1.0)
    for v in range(h):
        for u in range(w):
            if joins[v, u] & SQUARE:
                at = np.array([[u, v], [u + 1, v], [u, v + 1], [u + 1, v + 1]], float)
                depths = inverse[at[:, 1].astype(int), at[:, 0].astype(int)].astype(float)
                _square(at, depths, M, seen)
            if joins[v, u] & ALONE:
                at = np.array([u, v]) + np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]])
                _square(at, np.full(4, float(inverse[v, u])), M, seen)
    return seen


def _square(at, depths, M, seen):
    x, y, d, _ = land(M, at[:, 0], at[:, 1], depths)
    for corners in ([0, 1, 2], [3, 1, 2]):
        if np.isfinite(x).all() and (depths >= 0).all():
            _triangle(x[corners], y[corners], d[corners], seen)


def _triangle(x, y, d, seen):
    rows, columns = np.mgrid[: seen.shape[0], : seen.shape[1]]
    sides = np.array([[x[1] - x[0], x[2] - x[0]], [y[1] - y[0], y[2] - y[0]]])
    if np.linalg.det(sides) == 0:
        return
    b, c = np.tensordot(np.linalg.inv(sides), np.stack([columns - x[0], rows - y[0]]), 1)
    inside = (np.minimum(b, c) >= -1e-6) & (b + c <= 1 + 1e-6)
    np.copyto(seen, np.maximum(seen, d[0] + b * (d[1] - d[0]) + c * (d[2] - d[0])), where=inside)


def fuse(seen, views, rules):
    """Colours (height, width, 3), 0 to 255, and inverse depths (height, width); NaN where there is none."""
    n, height, width = seen.shape
    rgb, inverse = np.full((height, width, 3), np.nan), np.full((height, width), np.nan)
    for row in range(height):
        for column in range(width):
            offers = {i: float(seen[i, row, column]) for i in range(n) if seen[i, row, column] >= 0}
            if offers:
                inverse[row, column] = _elect(offers, views, rules, column, row)
                rgb[row, column] = _blend(inverse[row, column], views, rules, column, row)
    return rgb, inverse


def _ask(j, views, rules, x, y, d):
    """What view j says of inverse depth d at a pixel: agrees (True, False, None: nothing), trust, unlikeness, place."""
    M = views.there[j]
    u, v, expected, q2 = (float(value[0]) for value in land(M, np.array([x * 1.0]), np.array([y * 1.0]), np.array([d])))
    h, w = views.inverse[j].shape
    pace = float(np.hypot(M[0, 3] - u * M[2, 3], M[1, 3] - v * M[2, 3]))
    unlike = pace * d / q2 / rules.parallax_px + rules.shrinking * max(np.log(q2), 0)
    if not (-0.5 < u < w - 0.5 and -0.5 < v < h - 0.5):
        return None, 0.0, unlike, (u, v)
    at = int(v + 0.5), int(u + 0.5)
    share = max(rules.agree_share * expected, 1e-4)
    slack = min(share, max(rules.agree_px / pace, 0.1 * share)) if pace > 0 else share
    off = float(views.inverse[j][at]) - expected
    agrees = True if abs(off) <= slack else False if off < 0 else None
    return agrees, float(views.trust[j][at]), unlike, (u, v)


def _elect(offers, views, rules, x, y):
    unlike = {i: _ask(i, views, rules, x, y, d)[2] for i, d in offers.items()}
    likeness = {i: np.exp(-(value - min(unlike.values())) / rules.softness) for i, value in unlike.items()}

    def votes(i):
        own = rules.own_vote * likeness[i]
        total = own * (1 + _ask(i, views, rules, x, y, offers[i])[1])
        for j in range(len(views.inverse)):
            agrees, trust, *_ = _ask(j, views, rules, x, y, offers[i])
            total += 0 if j == i or agrees is None else trust if agrees else -trust
        return total

    counted = {i: votes(i) for i in offers}
    best = offers[max(offers, key=lambda i: (round(counted[i], 5), offers[i]))]
    near = {i: likeness[i] + 1e-9 for i in offers if abs(offers[i] - best) <= rules.agree_share * best + 1e-4}
    return sum(share * offers[i] for i, share in near.items()) / sum(near.values())


def _blend(d, views, rules, x, y):
    asked = {j: _ask(j, views, rules, x, y, d) for j in range(len(views.inverse))}
    seeing = {j: answer for j, answer in asked.items() if answer[0]}
    if not seeing:
        return np.nan
    least = min(answer[2] for answer in seeing.values())
    h, w = views.inverse[0].shape
    total, weight = np.zeros(3), 0.0
    for j, (_, trust, unlike, (u, v)) in seeing.items():
        feather = min(1, (min(u, v, w - 1 - u, h - 1 - v) + 0.5) / rules.feather_px) + 1e-3
        share = feather * (trust + 1e-3) * np.exp(-(unlike - least) / rules.softness)
        total, weight = total + share * colour_at(views.images[j], u, v), weight + share
    return total / weight


def colour_at(image, u, v):
    """Catmull-Rom's spline, by its basis matrix, along both axes."""
    basis = 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    h, w, _ = image.shape
    u, v = np.clip(u, 0, w - 1), np.clip(v, 0, h - 1)
    rows, columns = (np.clip(int(at) + np.arange(-1, 3), 0, most - 1) for at, most in ((v, h), (u, w)))
    down, across = ((at - int(at)) ** np.arange(4) @ basis for at in (v, u))
    return np.einsum("i,j,ijc->c", down, across, image[np.ix_(rows, columns)].astype(float))
