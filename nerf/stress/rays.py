"""Rays of samples for the table: packed as the kernels take them, and in float64 for the twin."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.stress.inputs import LONG
from nerf.types import Samples, padded_count
from priors.stress.inputs import EMPTY, ONE_PIXEL, Given
from priors.stress.precision import Floats

COUNTS = (14, 3, 0, 21, 1, 8)
"""Samples of each ray."""
LONGEST = 4096
REACH_M = 60.0


@dataclass(frozen=True)
class Packed:
    """Samples of some rays."""

    samples: Samples
    """float32, padded."""
    wide: Samples
    """The same numbers in float64."""
    norms: Tensor
    """(r,) metres along the ray per metre of camera-z depth, float32."""

    @property
    def rays(self) -> int:
        """How many rays there are."""
        return len(self.samples.offsets) - 1

    @property
    def used(self) -> int:
        """How many samples are real."""
        return self.samples.used

    def padded(self, values: Floats) -> Floats:
        """Return values (used, ...) with zeros where the padding is."""
        room = len(self.samples.ray) - self.used
        return np.concatenate([values, np.zeros((room, *values.shape[1:]))])

    def spoilt(self, values: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Tell which rays (r,) hold a value (used,) that is not finite."""
        return np.bincount(self.ray, ~np.isfinite(values), minlength=self.rays) > 0

    @property
    def ray(self) -> npt.NDArray[np.int64]:
        """The ray of each real sample."""
        return self.samples.ray[: self.used].numpy().astype(np.int64)


def counts(given: Given) -> tuple[int, ...]:
    """Return how many samples the rays have."""
    if given.input is EMPTY:
        return (0, 0, 0)
    if given.input is ONE_PIXEL:
        return (1,)
    return (LONGEST, 5) if given.input is LONG else COUNTS


def packed(given: Given, reach_m: float | None = None) -> Packed:
    """Make rays whose intervals follow each other from 2 m on over about so many metres of depth."""
    each = counts(given)
    reach_m = reach_m or {"1e-3 m": 1e-3, "1e6 m": 1e6}.get(given.input.name, REACH_M)
    used = sum(each)
    ray = np.repeat(np.arange(len(each)), each)
    norms = given.precision.rounded(given.random.uniform(1, 1.4, len(each)))
    s0, s1 = np.zeros(used), np.zeros(used)
    for first, last in zip(np.cumsum((0, *each[:-1])), np.cumsum(each), strict=True):
        edges = np.sort(given.random.uniform(0, 1, last - first + 1))
        s0[first:last], s1[first:last] = edges[:-1], edges[1:]
    s0, s1 = (x.astype(np.float32).astype(np.float64) for x in (s0, s1))
    t, dt_m = reach_m * (0.03 + (s0 + s1) / 2), reach_m * (s1 - s0) * norms[ray]
    return Packed(*_both(np.array([0, *np.cumsum(each)]), ray, (t, dt_m, s0, s1)), torch.from_numpy(norms).float())


def _both(
    offsets: npt.NDArray[np.int64], ray: npt.NDArray[np.int64], along: tuple[Floats, ...]
) -> tuple[Samples, Samples]:
    """Return the samples padded, in float32 and with the same numbers in float64."""
    room = padded_count(len(ray)) - len(ray)
    t, dt_m, s0, s1 = (torch.from_numpy(np.pad(x, (0, room)).astype(np.float32)) for x in along)
    index = torch.from_numpy(np.pad(ray, (0, room), constant_values=-1).astype(np.int32))
    places, table = torch.zeros(len(index), 3), torch.zeros(len(index), dtype=torch.int32)
    samples = Samples(torch.from_numpy(offsets), index, t, dt_m, s0, s1, places, table, len(ray))
    wide = replace(samples, t=t.double(), dt_m=dt_m.double(), s0=s0.double(), s1=s1.double())
    return samples, wide


def tensor(values: Floats) -> Tensor:
    """Return numbers as a float32 tensor."""
    with np.errstate(over="ignore", under="ignore"):
        return torch.from_numpy(np.ascontiguousarray(values.astype(np.float32)))


def wide(values: Floats) -> Tensor:
    """Return numbers as a float64 tensor."""
    return torch.from_numpy(np.ascontiguousarray(values))
