"""The metrics as their formulas read: one pixel at a time, exact sums. Slow, and what eval must equal."""

import math
import statistics
from fractions import Fraction

LARGEST = 3.4028234663852886e38
SMALLEST = 1.401298464324817e-45


def has_value(x):
    return not math.isnan(x) and SMALLEST <= x <= LARGEST


def mean(values):
    return math.fsum(values) / len(values) if values else math.nan


def depth_metrics(prediction, truth):
    """Figures of two equally long lists of depths, metres."""
    pairs = [(p, t) for p, t in zip(prediction, truth, strict=True) if has_value(p) and has_value(t)]
    true = [t for t in truth if has_value(t)]
    g = [math.log(p) - math.log(t) for p, t in pairs]
    exact = [Fraction(x) for x in g]
    n = len(pairs)
    variance = sum(x * x for x in exact) / n - (sum(exact) / n) ** 2 if n else math.nan
    within = [mean([float(max(p / t, t / p) < 1.25**k) for p, t in pairs]) for k in (1, 2, 3)]
    return {
        "delta_1": within[0],
        "delta_2": within[1],
        "delta_3": within[2],
        "abs_rel": mean([abs(p - t) / t for p, t in pairs]),
        "sq_rel": mean([(p - t) ** 2 / t for p, t in pairs]),
        "rmse": math.sqrt(mean([(p - t) ** 2 for p, t in pairs])),
        "rmse_log": math.sqrt(mean([x * x for x in g])),
        "silog": 100 * math.sqrt(variance),
        "log10": mean([abs(math.log10(p) - math.log10(t)) for p, t in pairs]),
        "mae": mean([abs(p - t) for p, t in pairs]),
        "irmse": 1000 * math.sqrt(mean([(1 / p - 1 / t) ** 2 for p, t in pairs])),
        "imae": 1000 * mean([abs(1 / p - 1 / t) for p, t in pairs]),
        "density": n / len(true) if true else math.nan,
        "density_image": mean([float(has_value(p)) for p in prediction]),
    }


def disparity_metrics(prediction, truth):
    """Figures of two equally long lists of disparities, px."""
    pairs = [(p, t) for p, t in zip(prediction, truth, strict=True) if has_value(p) and has_value(t)]
    return {
        "epe": mean([abs(p - t) for p, t in pairs]),
        "d1": 100 * mean([float(abs(p - t) > 3 and abs(p - t) / t > 0.05) for p, t in pairs]),
        "bad_1": 100 * mean([float(abs(p - t) > 1) for p, t in pairs]),
        "bad_2": 100 * mean([float(abs(p - t) > 2) for p, t in pairs]),
        "bad_3": 100 * mean([float(abs(p - t) > 3) for p, t in pairs]),
    }


def scored_pairs(prediction, truth, crop, min_m, max_m, clamp):
    """Prediction and truth (lists of rows) as two flat lists over the crop's pixels; 0 = no value or not scored."""
    height, width = len(truth), len(truth[0])
    top, bottom, left, right = crop(height, width)
    out = [], []
    for v in range(top, bottom):
        for u in range(left, right):
            p, t = prediction[v][u], truth[v][u]
            p = 0.0 if not has_value(p) else min(max(p, min_m), max_m) if clamp else p
            out[0].append(p)
            out[1].append(t if has_value(t) and min_m < t < max_m else 0.0)
    return out


def align(prediction, truth, how):
    """Fit a list of depths to another by median scale, or by the normal equations of scale and shift."""
    pairs = [(p, t) for p, t in zip(prediction, truth, strict=True) if p > 0 and t > 0]
    ps, ts = [p for p, _ in pairs], [t for _, t in pairs]
    scale, shift = statistics.median(ts) / statistics.median(ps), 0.0
    if how == "lsq":
        line = statistics.linear_regression(ps, ts)
        scale, shift = line.slope, line.intercept
    return [scale * p + shift if p > 0 else 0.0 for p in prediction]


def fill_rows(rows, choose):
    """Fill gaps (0) along rows by choose (min or max) of their two ends, then copy rows outwards, as KITTI does."""
    filled = [list(row) for row in rows]
    for row, old in zip(filled, rows, strict=True):
        known = [u for u, value in enumerate(old) if value > 0]
        for u in range(len(old)):
            if known and old[u] == 0:
                before, after = [k for k in known if k < u], [k for k in known if k > u]
                row[u] = choose([old[k] for k in (before[-1:] + after[:1])])
    whole = [v for v, row in enumerate(filled) if any(row)]
    for v in range(len(rows)):
        if whole and v < whole[0]:
            filled[v] = list(filled[whole[0]])
        if whole and v > whole[-1]:
            filled[v] = list(filled[whole[-1]])
    return filled


def kept_mean(error, confidence, kept):
    """Mean error of the `kept` most confident pixels (a whole number), averaged over every order of equals.

    Within a group of equals every pixel is as likely kept as another: it counts by that chance.
    """
    total = 0.0
    for e, c in zip(error, confidence, strict=True):
        better = sum(other > c for other in confidence)
        equal = sum(other == c for other in confidence)
        total += e * min(max(kept - better, 0) / equal, 1.0)
    return total / kept
