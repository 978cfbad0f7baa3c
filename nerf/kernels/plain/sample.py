"""Samplers in plain PyTorch, on any device and in any precision: the twin's candidates, padded to whole blocks."""

import torch
from torch import Tensor

from nerf.twin import sample as twin
from nerf.twin.occupancy import note as note
from nerf.twin.occupancy import prune as prune
from nerf.twin.space import stretch as stretch
from nerf.types import Course, Histogram, Samples, padded_count


def pick(course: Course, kept: Tensor | None, resolution: int) -> Samples:
    """Return the candidates whose middle lies in a kept cell (flat uint8 grid; None: all), padded."""
    return _padded(twin.pick(course, kept, resolution))


def resample(histogram: Histogram, targets: Tensor) -> Tensor:
    """Return the ends (2, r, n) in s of n intervals of even mass under a histogram."""
    return torch.stack(twin.resample(histogram, targets))


def _padded(samples: Samples) -> Samples:
    """Append the padding."""
    room = padded_count(samples.used) - samples.used

    def pad(x: Tensor, value: float = 0) -> Tensor:
        return torch.cat([x, x.new_full((room, *x.shape[1:]), value)])

    # Feature-major memory, as the encoders read it.
    u = pad(samples.u).T.contiguous().T
    t, dt_m, s0, s1 = (pad(x) for x in (samples.t, samples.dt_m, samples.s0, samples.s1))
    return Samples(samples.offsets, pad(samples.ray, -1), t, dt_m, s0, s1, u, pad(samples.table), samples.used)
