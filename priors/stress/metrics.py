"""Rows of the table: metrics of depth and disparity, error curves, and the protocol's alignment."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.curves import KEPT_SHARES, sparsify
from eval.depth import DepthSums
from eval.protocol import align
from eval.stereo import DisparitySums
from priors.stress.inputs import Given
from priors.stress.routine import NO_BFLOAT, NO_POSES, Case, Outputs, Routine

SIZE = (16, 24)
LARGEST, SMALLEST = float(np.finfo(np.float32).max), float(np.finfo(np.float32).smallest_subnormal)
Wide = npt.NDArray[np.longdouble]


def depth_metrics(given: Given) -> Case:
    """Score a map against a truth, both with extreme values."""
    size = given.size(*SIZE)
    prediction, truth = given.values(1, 80, size), given.plain(1, 80, size) * given.mask(0.7, size)
    ours, theirs = given.precision.array(prediction), given.precision.array(truth)
    return Case(
        found=lambda: DepthSums.over(ours, theirs).finish(),
        wanted=lambda: _depth_formulas(prediction, truth),
        scale=_depth_scales(prediction, truth),
    )


def _depth_formulas(prediction: Any, truth: Any) -> Outputs:
    """Return the table in eval/depth.py, in the widest numbers that numpy has."""
    p, t = _pairs(prediction, truth)
    n, true = p.size, int(np.count_nonzero(_valued(truth)))
    g = np.log(p / t)
    return {
        **{f"delta_{k}": _mean(np.maximum(p / t, t / p) < np.longdouble(1.25) ** k) for k in (1, 2, 3)},
        "abs_rel": _mean(abs(p - t) / t),
        "sq_rel": _mean((p - t) ** 2 / t),
        "rmse": _mean((p - t) ** 2) ** 0.5,
        "rmse_log": _mean(g**2) ** 0.5,
        "silog": 100 * _mean((g - (g.mean() if n else 0)) ** 2) ** 0.5,
        "log10": _mean(abs(np.log10(p / t))),
        "mae": _mean(abs(p - t)),
        "irmse": 1000 * _mean((1 / p - 1 / t) ** 2) ** 0.5,
        "imae": 1000 * _mean(abs(1 / p - 1 / t)),
        "density": n / true if true else math.nan,
        "density_image": float(np.mean(_valued(prediction))),
    }


def _depth_scales(prediction: Any, truth: Any) -> dict[str, float]:
    """A spread of logarithms that are all but equal is rounding: its scale is that of the logarithms."""
    p, t = _pairs(prediction, truth)
    logs = max(1.0, float(np.max(abs(np.log(p)), initial=0)), float(np.max(abs(np.log(t)), initial=0)))
    return {"silog": 100 * logs, "rmse_log": logs, "log10": logs}


def disparity_metrics(given: Given) -> Case:
    """Score a disparity map against a truth."""
    size = given.size(*SIZE)
    prediction, truth = given.values(2, 120, size), given.plain(2, 120, size) * given.mask(0.7, size)
    ours, theirs = given.precision.array(prediction), given.precision.array(truth)

    def formulas() -> Outputs:
        p, t = _pairs(prediction, truth)
        off = abs(p - t)
        bad = {f"bad_{k}": 100 * _mean(off > k) for k in (1, 2, 3)}
        return {"epe": _mean(off), "d1": 100 * _mean((off > 3) & (off / t > np.longdouble("0.05"))), **bad}

    return Case(found=lambda: DisparitySums.over(ours, theirs).finish(), wanted=formulas)


def error_curves(given: Given) -> Case:
    """Sort errors by a confidence, some of which are equal."""
    size = given.size(SIZE[0] * SIZE[1])
    error = given.plain(1e-3, 1, size)
    confidence = given.values(1e-3, 1, size)
    ours = given.precision.array(confidence).astype(np.float64)

    def formula() -> Outputs:
        """Take each group of equals by the share of it that is kept."""
        trust = np.where(np.isnan(confidence), -np.inf, confidence)
        heights = []
        for share in KEPT_SHARES:
            kept = share * error.size
            better = (trust[None] > trust[:, None]).sum(1)
            equal = (trust[None] == trust[:, None]).sum(1)
            chance = np.clip((kept - better) / equal, 0, 1)
            heights.append(math.fsum(error * chance) / kept)
        return {"error": np.array(heights)}

    return Case(found=lambda: {"error": sparsify(error, ours)}, wanted=formula)


def protocol_alignment(given: Given) -> Case:
    """Fit a map to its truth by medians and by a line, as protocols do before they score."""
    size = given.size(*SIZE)
    truth = given.plain(1, 80, size) * given.mask(0.8, size)
    prediction = np.where(truth > 0, given.precision.rounded(0.5 * truth + 1), given.values(1, 40, size))
    prediction = np.where(given.random.random(size) < 0.1, given.values(1, 40, size), prediction)
    ours = np.where(_valued(prediction), given.precision.array(prediction), 0).astype(np.float64)

    def formulas() -> Outputs:
        valued = _valued(prediction)
        known = np.where(valued, prediction, 0)
        p, t = _pairs(prediction, truth)
        if not p.size:
            return {"median": known, "lsq": known}
        off = p - p.mean()
        spread = float((off * off).sum())
        slope = (off * (t - t.mean())).sum() / spread if spread > 0 else np.longdouble(1)
        line = slope * known + (t.mean() - slope * p.mean())
        median = np.median(t) / np.median(p) * known
        return {"median": np.where(valued, median, 0), "lsq": np.where(valued, line, 0)}

    def found() -> Outputs:
        return {how: align(ours, truth, how) for how in ("median", "lsq")}

    wide = formulas()["lsq"]
    return Case(found=found, wanted=formulas, scale={"lsq": np.maximum(abs(wide), float(np.max(truth, initial=1)))})


def _valued(values: Any) -> Any:
    return (values >= SMALLEST) & (values <= LARGEST)


def _pairs(prediction: Any, truth: Any) -> tuple[Wide, Wide]:
    both = _valued(prediction) & _valued(truth)
    return prediction[both].astype(np.longdouble), truth[both].astype(np.longdouble)


def _mean(values: Any) -> float:
    return float(np.mean(values.astype(np.longdouble))) if values.size else math.nan


ROUTINES = (
    Routine("depth metrics", "eval/depth.py", depth_metrics, NO_POSES, NO_BFLOAT),
    Routine("disparity metrics", "eval/stereo.py", disparity_metrics, NO_POSES, NO_BFLOAT),
    Routine("error curves", "eval/curves.py", error_curves, NO_POSES, NO_BFLOAT),
    Routine("protocol's alignment", "eval/protocol.py", protocol_alignment, NO_POSES, NO_BFLOAT),
)
