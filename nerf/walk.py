"""Rendering near to far, a few samples of each ray at a time: a ray whose light is spent asks the field no more."""

import math

import torch
from torch import Tensor

from nerf.field import Field
from nerf.types import Samples

WAVE = 16
"""Samples of a ray that are looked at together: fewer look less far behind surfaces, and cost more calls."""


def walk(
    field: Field, samples: Samples, units: Tensor, footprint: Tensor | None, limit: float
) -> tuple[Tensor, Tensor]:
    """Return density (m,), 1/m, and colour (m, 3) of samples; both are 0 from a wave on that begins in the dark.

    So a ray's colour and opacity are off by less than the limit.

    Args:
        field: what is asked.
        samples: of r rays.
        units: (r, 3) unit directions.
        footprint: (m,) the samples' extents in units of u; None: points.
        limit: transmittance below which a ray ends, above 0.
    """
    at, ends = samples.offsets[:-1], samples.offsets[1:]
    if not len(units) or (ends - at).max() <= WAVE:  # a single wave
        return field.forward(samples, units, footprint)
    sigma, rgb = torch.zeros_like(samples.t), samples.t.new_zeros(len(samples.t), 3)
    optical = torch.zeros(len(units), dtype=torch.float64, device=units.device)
    while True:
        count = torch.where(optical < -math.log(limit), (ends - at).clamp(max=WAVE), 0)
        before = torch.cumsum(count, 0) - count
        total = int(count.sum())
        if not total:
            return sigma, rgb
        index = torch.repeat_interleave(at - before, count) + torch.arange(total, device=units.device)
        part = _part(samples, index)
        extent = None if footprint is None else footprint.index_select(0, index)
        thick, colour = field.forward(part, units, extent)
        sigma[index], rgb[index] = thick, colour
        optical.index_add_(0, part.ray.long(), (thick * part.dt_m).double())
        at = at + count


def _part(samples: Samples, index: Tensor) -> Samples:
    """Return the samples at places (n,): what the field asks of them, and their lengths."""
    u = samples.u.T.index_select(1, index).T
    ray, table, dt_m = (x.index_select(0, index) for x in (samples.ray, samples.table, samples.dt_m))
    return Samples(samples.offsets, ray, dt_m, dt_m, dt_m, dt_m, u, table, len(index))


def in_front(samples: Samples, sigma: Tensor) -> Tensor:
    """Return the optical depth (m,), float64, between the camera and each sample of density (m,), 1/m."""
    tau = (sigma * samples.dt_m).double()
    passed = torch.cumsum(tau, 0) - tau
    return passed - passed[samples.offsets[samples.ray.long().clamp(min=0)]]
