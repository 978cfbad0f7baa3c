"""Scale, or scale and shift, of a depth prior to depths that are known: LiDAR, a sparse map, stereo.

A network that saw one image knows the shape of a scene better than its size. What it leaves open is fitted to known
depths z: in depth, z = a v + b, or in disparity, 1 / z = a v + b with v the network's disparity or one over its depth.
Minimised is the relative error, so that near and far count alike, and of what is off by far nothing (Tukey's biweight).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.types import FloatMap

Floats: TypeAlias = npt.NDArray[np.floating]
Kind: TypeAlias = Literal["scale", "scale-shift"]
Space: TypeAlias = Literal["depth", "disparity"]

PAIRS, JUDGES = 400, 2000  # lines through two samples that are tried, and samples that judge them
ALIGN_ROUNDS = 20
BIWEIGHT = 4.685  # 95 % efficiency where the noise is Gaussian
SHARPEST = 1e-7  # of a relative error: below it lies rounding
FEWEST = 2


@dataclass(frozen=True, slots=True)
class Alignment:
    """The line that turns a network's values into depth."""

    scale: float
    shift: float
    """Metres in depth, 1/m in disparity."""
    space: Space

    def apply(self, values: FloatMap) -> FloatMap:
        """Turn values (height, width) of this space into metres; 0 where there is no value or no surface is so far."""
        line = np.float64(self.scale) * values + self.shift
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            depth_m = (line if self.space == "depth" else 1 / line).astype(np.float32)
        return np.where((values > 0) & (line > 0) & np.isfinite(depth_m), depth_m, np.float32(0))


@dataclass(frozen=True, slots=True)
class Aligner:
    """Fits lines between a network's values and known depth, and turns values into depth by them."""

    kind: Kind
    space: Space
    """Where the line is."""
    values_in: Space
    """What the network gives."""

    def fit(self, values: Sequence[FloatMap], known_m: Sequence[FloatMap], where: str) -> Alignment:
        """Fit one line to all frames' values and known depth (height, width), 0 = none.

        Raises DataError, which names `where`, as the function `fit` does.
        """
        known = [map_m > 0 for map_m in known_m]
        ours = [self._convert(map_)[mask] for map_, mask in zip(values, known, strict=True)]
        theirs_m = [map_m[mask] for map_m, mask in zip(known_m, known, strict=True)]
        try:
            return fit(np.concatenate(ours), np.concatenate(theirs_m), self.kind, self.space)
        except DataError as error:
            raise DataError(f"{where}: {error}") from error

    def apply(self, line: Alignment, values: FloatMap) -> FloatMap:
        """Turn a network's values (height, width) into metres by a line; 0 = none."""
        return line.apply(self._convert(values))

    def _convert(self, values: FloatMap) -> FloatMap:
        """Turn the network's values into the space of the line: depth into disparity or back."""
        if self.values_in == self.space:
            return values
        with np.errstate(divide="ignore"):
            return np.where(values > 0, 1 / values, np.float32(0)).astype(np.float32)


def fit(values: FloatMap, known_m: FloatMap, kind: Kind, space: Space) -> Alignment:
    """Fit the line to the samples that have a value and a known depth (any equal shapes; 0 or not finite = none).

    With two samples or fewer, or equal values everywhere, a shift cannot be told and only the scale is fitted; likewise
    where the best line falls (far would be near).

    Raises DataError where no sample has both.
    """
    given, known = np.ravel(values).astype(np.float64), np.ravel(known_m).astype(np.float64)
    with np.errstate(invalid="ignore"):
        both = np.isfinite(given) & np.isfinite(known) & (given > 0) & (known > 0)
    v: Floats = given[both]
    y: Floats = known[both] if space == "depth" else 1 / known[both]
    if not len(v):
        raise DataError("nothing to align to: no pixel has both a value and a known depth")
    v = v / y  # a v + b against y, as a share of y
    if kind == "scale-shift" and len(v) > FEWEST:
        start = _start_line(v, 1 / y)
        line = np.zeros(2) if start is None else _settle(np.stack([v, 1 / y], axis=1), start)
        if line[0] > 0:
            return Alignment(float(line[0]), float(line[1]), space)
    (scale,) = _settle(v[:, None], np.array([1 / np.median(v)]))
    return Alignment(float(scale), 0.0, space)


def _start_line(v: Floats, one: Floats) -> Floats | None:
    """Return the line a v + b * one = 1 through two samples whose median error is least (Rousseeuw, 1984)."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(v), (2, PAIRS))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Cramer's rule on a v1 + b o1 = 1, a v2 + b o2 = 1
        determinant = v[first] * one[second] - v[second] * one[first]
        a = (one[second] - one[first]) / determinant
        b = (v[first] - v[second]) / determinant
    usable = np.isfinite(a) & np.isfinite(b)
    if not usable.any():
        return None
    a, b = a[usable], b[usable]
    judges = rng.permutation(len(v))[:JUDGES]
    errors = np.abs(a[:, None] * v[judges] + b[:, None] * one[judges] - 1)
    best = int(np.argmin(np.median(errors, axis=1)))
    return np.array([a[best], b[best]])


def _settle(columns: Floats, line: Floats) -> Floats:
    """Refine columns (n, k) @ line = 1 by least squares, reweighted by Tukey's biweight of each sample's error."""
    for _ in range(ALIGN_ROUNDS):
        error = columns @ line - 1
        spread = max(1.4826 * float(np.median(np.abs(error))), SHARPEST)
        weight = np.clip(1 - (error / (BIWEIGHT * spread)) ** 2, 0, None)  # its square root: 1 - (e / c)^2
        settled, *_ = np.linalg.lstsq(columns * weight[:, None], weight, rcond=None)
        if np.allclose(settled, line, rtol=1e-9, atol=0):
            break
        line = settled
    return line
