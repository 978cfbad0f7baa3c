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
from priors.stress.tolerances import PLACES, STEP


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
    """Return the largest error of the gradients against central differences."""
    errors = []
    for name, at in gradient.at.items():
        ours = as_array(found[name]).astype(np.float64)
        if ours.shape != at.shape:
            return math.inf
        finite = np.flatnonzero(np.isfinite(at))
        places = random.permutation(finite)[:PLACES]
        slopes = np.array([_slope(gradient, name, place) for place in places])
        known = np.isfinite(slopes)
        if not known.any():
            continue
        scale = gradient.scale.get(name, float(np.abs(slopes[known]).max()))
        off = np.abs(ours.reshape(-1)[places] - slopes)[known] / max(scale, float(np.finfo(np.float32).tiny))
        errors.append(float(np.max(np.where(np.isnan(off), np.inf, off))))
    return max(errors) if errors else None


def _slope(gradient: Gradient, name: str, place: int) -> float:
    """Return the central difference of the loss by one value."""
    at = gradient.at[name]
    usual = np.abs(at[np.isfinite(at) & (at != 0)])
    step = STEP * max(abs(float(at.reshape(-1)[place])), float(np.median(usual)) if usual.size else 1.0)
    ends = []
    for side in (1, -1):
        moved = at.copy()
        moved.reshape(-1)[place] += side * step
        ends.append((gradient.loss({**gradient.at, name: moved}), moved.reshape(-1)[place]))
    (above, high), (below, low) = ends
    return (above - below) / (high - low)
