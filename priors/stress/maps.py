"""Rows of the table: filters of depth maps, and the smoothing of a matched disparity map."""

import math

import numpy as np

from priors import filters
from priors.kernels import diffusion
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_BFLOAT, NO_MASK, NO_POSES, Case, Outputs, Routine
from priors.types import Depth

SIZE = (12, 20)
SHARE, CLIP_M, LEAST, AGREE_PX, STRENGTH = 0.37, 40.0, 0.5, 1.5, 45.0


def depth_filters(given: Given) -> Case:
    """Apply every filter that works on numbers; a filter keeps values as they are, or drops them."""
    size = given.size(*SIZE)
    depth_m, trust = given.values(1, 80, size), given.values(0.05, 1, size)
    depth_m, trust = np.where(np.isnan(depth_m), 0, depth_m), np.where(np.isinf(trust), 1, trust)
    given_map = Depth(given.precision.array(depth_m), given.precision.array(trust))

    def found() -> Outputs:
        kept = {
            "sky rows": filters.crop_rows(given_map, SHARE),
            "clip": filters.clip(given_map, CLIP_M),
            "confidence": filters.keep_confident(given_map, LEAST),
            "keep": filters.keep_best(given_map, SHARE),
            "density": filters.keep_random(given_map, SHARE),
        }
        counts = {name: int(np.count_nonzero(kept.pop(name).valid)) for name in ("keep", "density")}
        return {**{name: map_.depth_m for name, map_ in kept.items()}, **counts}

    def wanted() -> Outputs:
        has = depth_m > 0
        rows = np.arange(size[0])[:, None] >= math.floor(SHARE * size[0] + 0.5)
        count = math.floor(SHARE * int(has.sum()) + 0.5)
        keeps = {"sky rows": rows, "clip": depth_m <= CLIP_M, "confidence": np.nan_to_num(trust) >= LEAST}
        return {
            **{name: np.where(has & kept, depth_m, 0) for name, kept in keeps.items()},
            "keep": count,
            "density": count,
        }

    return Case(found, wanted)


def left_right_check(given: Given) -> Case:
    """Keep what the other view confirms."""
    size = given.size(*SIZE)
    ours_px, theirs_px = given.values(0.5, 12, size), given.values(0.5, 12, size)
    depth = Depth(np.where(np.isfinite(ours_px) & (ours_px > 0), 5, 0).astype(np.float32))
    ours, theirs = given.precision.array(ours_px), given.precision.array(theirs_px)

    def wanted() -> Outputs:
        kept = np.zeros(size)
        for row, column in np.argwhere(depth.depth_m > 0):
            lands = np.rint(column - ours_px[row, column])
            if 0 <= lands < size[1]:
                other = theirs_px[row, int(lands)]
                kept[row, column] = 5 * (other > 0 and abs(other - ours_px[row, column]) <= AGREE_PX)
        return {"kept": kept}

    return Case(lambda: {"kept": filters.keep_agreeing(depth, theirs, ours, -1, AGREE_PX).depth_m}, wanted)


def column_smoothing(given: Given) -> Case:
    """Spread values along columns: the solution of a tridiagonal system in each."""
    size = given.size(*SIZE)
    values = given.values(0.5, 60, size)
    links = given.precision.rounded(given.random.uniform(0, 1, size))
    links[-1] = 0
    ours, ties = (np.asarray(given.precision.array(x), np.float32) for x in (values, links))

    def found() -> Outputs:
        first, second = ours.copy(), np.ones_like(ours)
        diffusion.diffuse_columns(first, second, ties, STRENGTH)
        return {"values": first, "ones": second}

    def wanted() -> Outputs:
        return {"values": _diffused(values, links), "ones": np.ones(size)}

    largest = np.max(np.where(np.isfinite(values), values, 0), axis=0, initial=0)
    return Case(found, wanted, {"values": np.broadcast_to(largest, size)}, spreads=True)


def _diffused(values: Floats, links: Floats) -> Floats:
    """Solve (I + strength L) u = values, column by column; one that is not finite makes its column NaN."""
    from scipy.linalg import solve_banded

    out = np.full(values.shape, np.nan)
    for x in range(values.shape[1]):
        if not np.isfinite(values[:, x]).all():
            continue
        tie = STRENGTH * links[:, x]
        above = np.concatenate([[0], tie[:-1]])
        out[:, x] = solve_banded((1, 1), np.stack([-above, 1 + above + tie, -tie]), values[:, x])
    return out


ROUTINES = (
    Routine("filters", "priors/filters.py", depth_filters, NO_POSES, NO_BFLOAT),
    Routine("left-right check", "priors/filters.py", left_right_check, NO_POSES, NO_BFLOAT),
    Routine("smoothing", "priors/kernels/diffusion.py", column_smoothing, {**NO_POSES, **NO_MASK}, FLOAT32_ONLY),
)
