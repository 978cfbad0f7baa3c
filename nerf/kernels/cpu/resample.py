"""Inverse transform sampling, compiled: nerf/twin/sample.py, resample, in one pass a ray."""

import numpy as np

from priors.machine.compiled import compiled


@compiled(error_model="numpy")
def _widen(s0, s1, weights, margin, edges, mass, gap):  # type: ignore[no-untyped-def]
    """Fill the edges (2b,) of the widened bins, and of the spaces between them mass and gap (2b - 1,)."""
    bins = s0.size
    i, j = 0, 0
    for k in range(2 * bins):
        low = max(np.float64(s0[i]) - margin, 0.0) if i < bins else np.inf
        high = min(np.float64(s1[j]) + margin, 1.0)
        if low <= high:
            edges[k] = low
            i += 1
        else:
            edges[k] = high
            j += 1
    first = 0
    for k in range(2 * bins - 1):
        middle = (edges[k + 1] + edges[k]) * 0.5
        while first < bins and min(np.float64(s1[first]) + margin, 1.0) < middle:
            first += 1
        highest, covered = 0.0, False
        i = first
        while i < bins and max(np.float64(s0[i]) - margin, 0.0) <= middle:
            covered = True
            width = np.float64(s1[i]) - np.float64(s0[i])
            if width > 0:
                highest = max(highest, np.float64(weights[i]) / max(width, 1e-30))
            i += 1
        mass[k] = highest * (edges[k + 1] - edges[k])
        gap[k] = not covered


@compiled(error_model="numpy")
def _anneal(mass, gap, edges, power, cumulated):  # type: ignore[no-untyped-def]
    """Raise the masses to a power and cumulate them (2b,) up to 1; widths instead where there is no mass."""
    total = 0.0
    for k in range(mass.size):
        if mass[k] > 0:
            mass[k] = max(mass[k], 1e-30) if power == 1.0 else max(mass[k], 1e-30) ** power
            total += mass[k]
    if total <= 0:
        for k in range(mass.size):
            mass[k] = 0.0 if gap[k] else edges[k + 1] - edges[k]
    cumulated[0] = 0.0
    for k in range(mass.size):
        cumulated[k + 1] = cumulated[k] + mass[k]
    last = max(cumulated[mass.size], 1e-30)
    for k in range(mass.size + 1):
        cumulated[k] /= last


@compiled(error_model="numpy", inline="always")
def _reach(cumulated, edges, target, space):  # type: ignore[no-untyped-def]
    """Return where the mass reaches the target and in which space, looking from `space` on."""
    while space < cumulated.size - 2 and cumulated[space + 1] <= target:
        space += 1
    before = cumulated[space]
    share = (target - before) / max(cumulated[space + 1] - before, 1e-30)
    return edges[space] + min(max(share, 0.0), 1.0) * (edges[space + 1] - edges[space]), space


@compiled(error_model="numpy")
def invert(offsets, s0, s1, weights, targets, margin, power, ends, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Set ends (2, r, n) in s of some rays from a packed histogram and targets (r, n + 1), ascending; see the twin."""
    count = targets.shape[1] - 1
    for ray in range(first_ray, last_ray):
        own = slice(offsets[ray], offsets[ray + 1])
        bins = offsets[ray + 1] - offsets[ray]
        if bins == 0:
            ends[:, ray] = 0
            continue
        edges, cumulated = np.empty(2 * bins), np.empty(2 * bins)
        mass, gap = np.empty(2 * bins - 1), np.empty(2 * bins - 1, np.bool_)
        _widen(s0[own], s1[own], weights[own], margin, edges, mass, gap)
        _anneal(mass, gap, edges, power, cumulated)
        begin, space = _reach(cumulated, edges, np.float64(targets[ray, 0]), 0)
        middle = 0
        for i in range(count):
            end, space = _reach(cumulated, edges, np.float64(targets[ray, i + 1]), space)
            half = (np.float64(targets[ray, i + 1]) + np.float64(targets[ray, i])) * 0.5
            _, middle = _reach(cumulated, edges, half, middle)
            first, last = middle, middle
            while first > 0 and edges[first] > begin and not gap[first - 1]:
                first -= 1
            while last < gap.size - 1 and edges[last + 1] < end and not gap[last + 1]:
                last += 1
            low = max(begin, edges[first])
            ends[0, ray, i] = low
            ends[1, ray, i] = max(low, min(end, edges[last + 1]))
            begin = end
