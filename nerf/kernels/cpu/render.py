"""The renderer on the CPU: tensors to the compiled loops and back, without copies; rays are tasks of the pool."""

from typing import Any

import torch
from torch import Tensor

from nerf.kernels.cpu import composite
from nerf.kernels.cpu import sky as environment
from nerf.twin import sky as plain
from nerf.types import OPACITY_FLOOR, Gradients, Rendered, Samples, Target
from priors.machine import threads


def forward(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite samples near to far."""
    rays = len(samples.offsets) - 1
    each = torch.empty(3, rays)
    out = Rendered(torch.empty(rays, 3), each[0], each[1], each[2], torch.empty_like(sigma))
    filled = (out.rgb, out.depth_m, out.median_m, out.transmittance, out.weights)
    arrays = (samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky)
    _run(composite.forward, rays, (*arrays, OPACITY_FLOOR), filled)
    out.weights[samples.used :] = 0
    return out


def backward(
    samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the derivatives by sigma, rgb and sky."""
    d_sigma, d_rgb, d_sky = torch.empty_like(sigma), torch.empty_like(rgb), torch.empty_like(sky)
    arrays = (samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky)
    forward_results = (rendered.depth_m, rendered.transmittance, rendered.weights)
    d_results = (gradients.rgb, gradients.depth_m, gradients.transmittance, gradients.weights, gradients.tau)
    _run(composite.backward, len(sky), (*arrays, OPACITY_FLOOR, *forward_results, *d_results), (d_sigma, d_rgb, d_sky))
    d_sigma[samples.used :] = 0
    d_rgb[samples.used :] = 0
    return d_sigma, d_rgb, d_sky


def kl(samples: Samples, sigma: Tensor, target: Target, scale: Tensor, d_tau: Tensor) -> Tensor:
    """Return the KL loss (r,), add its gradient to d_tau (m,)."""
    loss = torch.empty_like(target.prior_m)
    arrays = (samples.offsets, sigma, samples.dt_m, samples.t, *target, scale)
    _run(composite.kl, len(scale), arrays, (loss, d_tau))
    return loss


def sight(samples: Samples, weights: Tensor, target: Target, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""
    loss = torch.empty_like(target.prior_m)
    arrays = (samples.offsets, weights, samples.dt_m, samples.t, *target, scale)
    _run(composite.sight, len(scale), arrays, (loss, d_weights))
    return loss


def distortion(samples: Samples, weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return the distortion (r,), add its gradient to d_weights (m,)."""
    loss = torch.zeros(len(scale))
    arrays = (samples.offsets, weights, samples.s0, samples.s1, scale)
    _run(composite.distortion, len(scale), arrays, (loss, d_weights))
    return loss


def interlevel(
    samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor, scale: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""
    loss, d_coarse = torch.empty(len(scale)), torch.empty_like(coarse_weights)
    fine = (samples.offsets, weights, samples.s0, samples.s1)
    arrays = (*fine, coarse.offsets, coarse_weights, coarse.s0, coarse.s1, scale)
    _run(composite.interlevel, len(scale), arrays, (loss, d_coarse))
    d_coarse[coarse.used :] = 0
    return loss, d_coarse


def look(texels: Tensor, units: Tensor, sizes: tuple[int, ...]) -> Tensor:
    """Return the sums of the sky's pictures; the loops know float32 alone: elsewhere the twin answers."""
    if units.dtype != torch.float32:
        return plain.look(texels, units, sizes)
    sums = torch.empty(len(units), 3)
    _run(environment.look, len(units), (texels, units, sizes), (sums,))
    return sums


def paint(d_sums: Tensor, units: Tensor, sizes: tuple[int, ...], d_texels: Tensor) -> None:
    """Set the texels' gradient."""
    arrays = (x.contiguous().numpy() for x in (d_sums, units))
    environment.paint(*arrays, sizes, d_texels.numpy())


def _run(loop: Any, rays: int, read: tuple[Any, ...], filled: tuple[Tensor, ...]) -> None:
    """Run a loop over rays; what it reads is made contiguous, what it fills is filled where it lies."""
    views = [value.contiguous().numpy() if isinstance(value, Tensor) else value for value in read]
    views += [tensor.numpy() for tensor in filled]
    threads.over(rays, lambda first, last: loop(*views, first, last))
