"""Completion's kernels as loops over everything: slow, obvious, and what the fast ones must equal."""

import numpy as np

BESIDE, BESIDE_PX, BETWEEN_PX, NEAR = 1 / 3, 1, 2, 0.05


def covered(samples, pull_y, pull_x, gap_y, gap_x, reach_y, reach_x, behind):
    """How likely each sample (row, column, inverse) is covered by the nearer ones around it."""
    likely = np.zeros(len(samples))
    for i, (y, x, q) in enumerate(samples):
        pull = abs(pull_y[i]) + abs(pull_x[i])
        beside, free, sides = False, 1.0, set()
        for r, c, p in samples:
            if abs(r - y) > reach_y or abs(c - x) > reach_x or p <= max(q * behind, q + BESIDE_PX / pull):
                continue
            away = np.hypot((y - r) / gap_y, (x - c) / gap_x)
            if away < 1:
                beside = True
                shift_gaps = away * max(0, (p - q) * np.dot((pull_y[i], pull_x[i]), (y - r, x - c)))
                free *= min(1, away / min(1, away + shift_gaps / ((y - r) ** 2 + (x - c) ** 2)))
            if (p - q) * pull > BETWEEN_PX:
                sides |= {(v, h) for v in (-1, 1) for h in (-1, 1) if v * (r - y) >= 0 and h * (c - x) >= 0}
        between = {(-1, -1), (1, 1)} <= sides or {(-1, 1), (1, -1)} <= sides
        likely[i] = 1 if between else max(BESIDE if beside else 0, 1 - free)
    return likely


def slopes(samples, reach_y, reach_x, tolerance, ridge):
    """The plane around each sample, by the normal equations of weighted least squares about the weighted mean."""
    found = np.zeros((len(samples), 2))
    for i, (y, x, q) in enumerate(samples):
        rows = [s for s in samples if abs(s[0] - y) <= reach_y and abs(s[1] - x) <= reach_x]
        at = np.array([(r - y, c - x) for r, c, _ in rows], float)
        value = np.array([p - q for _, _, p in rows])
        weight = 1 / (1 + 4 * ((at / (reach_y, reach_x)) ** 2).sum(1)) / (1 + (value / tolerance[i]) ** 2) ** 2
        weight /= weight.sum()
        at, value = at - weight @ at, value - weight @ value
        found[i] = np.linalg.solve(at.T @ (weight[:, None] * at) + ridge * np.eye(2), at.T @ (weight * value))
    return found


def spread(samples, slope, handicap, guide, reach_y, reach_x, per_y, per_x, contrast, agree, agree_per_m):
    """Every pixel: cost and value of its cheapest sample, and the average of the planes that agree with it."""
    height, width = guide.shape
    cost, value, mean = np.full(guide.shape, np.inf), np.zeros(guide.shape), np.zeros(guide.shape)
    for y in range(height):
        for x in range(width):
            planes, flat = [], []
            for i, (r, c, q) in enumerate(samples):
                dy, dx = y - r, x - c
                if abs(dy) > reach_y or not -reach_x <= dx < reach_x:
                    continue
                plane = q + slope[i][0] * dy + slope[i][1] * dx
                apart = handicap[i] + per_y * dy**2 + per_x * dx**2
                here = apart + contrast * (float(guide[y, x]) - float(guide[r, c])) ** 2
                planes.append(plane)
                flat.append(apart)
                if here < cost[y, x]:
                    cost[y, x], value[y, x] = here, plane
            if planes:
                off = (np.array(planes) - value[y, x]) / (agree * value[y, x] + agree_per_m)
                weight = 1 / (NEAR + np.array(flat)) ** 2 / (1 + off**2) ** 2
                mean[y, x] = weight @ planes / weight.sum()
    return cost, value, mean


def settle(cost, mean, coarse, sure, step):
    """Inverse depth and certainty, holes read bilinearly from the map that is step times smaller."""
    dense, certain = mean.copy(), 1 / (1 + cost)
    for y, x in np.argwhere(np.isinf(cost)):
        v = np.clip((y + 0.5) / step - 0.5, 0, coarse.shape[0] - 1)
        u = np.clip((x + 0.5) / step - 0.5, 0, coarse.shape[1] - 1)
        weights = np.outer(tent(v, coarse.shape[0]), tent(u, coarse.shape[1]))
        dense[y, x], certain[y, x] = (weights * coarse).sum(), 0.5 * (weights * sure).sum()
    return dense, certain


def tent(place, count):
    return np.maximum(0, 1 - np.abs(np.arange(count) - place))
