"""Measuring a case: the largest error of its values and of its gradient, in units of their natural scale."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from priors.stress.precision import Floats
from priors.stress.routine import Case, Gradient
from priors.stress.tolerances import LEAST, PLACES, STEP


@dataclass(frozen=True, slots=True)
class Measured:
    """What a case showed."""

    value: float | None = None
    """Largest error of a value, of its natural scale; inf where one is finite that must not be, or the other way."""
    gradient: float | None = None
    """Largest error of a gradient; None where the routine has none, or nothing is left to differentiate by."""
    fault: str = ""
    """What else is wrong: an error, a warning, a result that is missing."""
    stated: str = ""
    """The stated answer, where it is not a number."""


def measure(case: Case, random: np.random.Generator) -> Measured:
    """Run a case and compare."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            found = case.found()
            gradients = case.gradient.found() if case.gradient else {}
        except Exception as error:  # any error at all is the finding
            return _raised(case, error)
    if case.raises is not None:
        return Measured(fault=f"expected {case.raises.__name__}, found a result")
    with np.errstate(all="ignore"):
        wanted = case.wanted()
        missing = set(wanted) ^ set(found)
        errors = {name: _error(found[name], wanted[name], case, name) for name in wanted if name in found}
        slope = _gradient_error(case.gradient, gradients, random) if case.gradient else None
    warned = next((str(each.message) for each in told if issubclass(each.category, RuntimeWarning)), "")
    fault = f"results differ: {', '.join(sorted(missing))}" if missing else f"warns: {warned}" if warned else ""
    return Measured(max(errors.values(), default=0.0), slope, fault, _stated(case, wanted))


def _raised(case: Case, error: Exception) -> Measured:
    if case.raises is not None and isinstance(error, case.raises):
        return Measured(stated=f"{case.raises.__name__}")
    return Measured(fault=f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}")


def _stated(case: Case, wanted: Mapping[str, Any]) -> str:
    some = any(not np.isfinite(np.asarray(each, np.float64)).all() for each in wanted.values())
    return "not finite where it depends on it" if case.spreads and some else ""


def _error(found: Any, wanted: Any, case: Case, name: str) -> float:
    """Return the largest error of one result."""
    ours, theirs = as_array(found), np.asarray(wanted, np.float64)
    if ours.shape != theirs.shape:
        return math.inf
    limits = np.finfo(ours.dtype) if ours.dtype.kind == "f" else np.finfo(np.float64)
    scale = np.maximum(np.broadcast_to(np.abs(case.scale.get(name, theirs)), theirs.shape), float(limits.tiny))
    return worst(ours.astype(np.float64), theirs, np.where(np.isfinite(scale), scale, 1.0), float(limits.max), case)


def worst(ours: Floats, theirs: Floats, scale: Floats, largest: float, case: Case) -> float:
    """Return the largest error of numbers against what they should be; what the type cannot hold must be infinite."""
    theirs = np.where(np.abs(theirs) > largest, np.copysign(np.inf, theirs), theirs)
    finite = np.isfinite(theirs)
    alike = ~np.isfinite(ours) if case.spreads else np.where(np.isnan(theirs), np.isnan(ours), ours == theirs)
    off = np.where(finite, np.abs(ours - theirs) / scale, np.where(alike, 0.0, np.inf))
    return float(np.max(np.where(np.isnan(off), np.inf, off), initial=0.0))


def as_array(values: Any) -> npt.NDArray[Any]:
    """Return numbers or a tensor of any type as an array; bfloat16 as float32."""
    if hasattr(values, "detach"):
        tensor = values.detach()
        return np.asarray((tensor.float() if str(tensor.dtype) == "torch.bfloat16" else tensor).numpy())
    return np.asarray(values)


def _gradient_error(gradient: Gradient, found: Mapping[str, Any], random: np.random.Generator) -> float | None:
    """Return the largest error of the gradients against central differences, beyond what these leave open."""
    errors = []
    for name, at in gradient.at.items():
        ours = as_array(found[name]).astype(np.float64)
        if ours.shape != at.shape:
            return math.inf
        places = _places(ours, at, gradient.smooth.get(name, np.ones(at.shape, bool)), random)
        slopes = np.array([_slope(gradient, name, place) for place in places]).reshape(-1, 2)
        slopes = np.concatenate([slopes, ours.reshape(-1)[places, None]], axis=1)[np.isfinite(slopes).all(axis=1)]
        if not len(slopes):
            continue
        slope, open_, given = slopes.T
        largest = max(float(np.abs(slope).max()), float(np.abs(ours[np.isfinite(ours)]).max(initial=0)))
        largest = max(largest, _least(gradient, at))
        off = np.maximum(np.abs(given - slope) - open_, 0)
        off = off / gradient.scale.get(name, max(largest, float(np.finfo(np.float32).tiny)))
        errors.append(float(np.max(np.where(np.isnan(off), np.inf, off))))
    return max(errors) if errors else None


def _least(gradient: Gradient, at: Floats) -> float:
    """Return the gradient by which a usual value moves LEAST of the loss: a smaller one has this natural scale."""
    parts = np.abs(np.asarray(gradient.loss(gradient.at)))
    return LEAST * float(parts[np.isfinite(parts)].sum()) / (_usual(at) or 1.0)


def _usual(at: Floats) -> float:
    """Return the usual size of an argument's values; 0 where it has none but 0."""
    usual = np.abs(at[np.isfinite(at) & (at != 0)])
    return float(np.median(usual)) if usual.size else 0.0


def _places(
    ours: Floats, at: Floats, smooth: npt.NDArray[np.bool_], random: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Choose values to move: one where the gradient is largest, one where it is not finite, and some others."""
    finite = np.isfinite(at.reshape(-1)) & smooth.reshape(-1)
    slopes = np.where(finite, np.abs(ours.reshape(-1)), -1)
    chosen = random.permutation(np.flatnonzero(finite))[:PLACES]
    if finite.any():
        spoilt = np.flatnonzero(finite & ~np.isfinite(slopes))[:1]
        chosen = np.concatenate([[np.argmax(np.where(np.isfinite(slopes), slopes, -1))], spoilt, chosen])
    return np.unique(chosen).astype(np.int64)


def _slope(gradient: Gradient, name: str, place: int) -> tuple[float, float]:
    """Return the central difference of the loss by one value, and what it leaves open.

    That is by how much another step gives another one, at a kink, and the rounding of the loss's parts.
    """
    short, rounding = _difference(gradient, name, place, STEP)
    long, _ = _difference(gradient, name, place, 4 * STEP)
    return short, abs(short - long) + rounding


def _difference(gradient: Gradient, name: str, place: int, share: float) -> tuple[float, float]:
    """Return the central difference with one step, and its rounding."""
    at = gradient.at[name]
    step = share * max(abs(float(at.reshape(-1)[place])), _usual(at) or 1.0)
    ends = []
    for side in (1, -1):
        moved = at.copy()
        moved.reshape(-1)[place] += side * step
        ends.append((np.asarray(gradient.loss({**gradient.at, name: moved})), moved.reshape(-1)[place]))
    (above, high), (below, low) = ends
    moves = above != below  # what does not depend on it has no part in the rounding
    rounding = float(np.abs(above[moves]).sum()) * 4 * float(np.finfo(np.float64).eps)
    return float((above - below)[moves].sum()) / (high - low), rounding / (high - low)
