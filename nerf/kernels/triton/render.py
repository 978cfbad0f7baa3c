"""The renderer on GPUs: tensors to the Triton kernels and back; nothing waits for the device."""

import torch
from torch import Tensor

from nerf.kernels.triton import composite
from nerf.twin.sky import look as look
from nerf.twin.sky import paint as paint
from nerf.types import OPACITY_FLOOR, Gradients, Rendered, Samples, Target

_RAYS = 32
"""Rays a program: one a thread of its one warp."""


def forward(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite samples near to far."""
    depth_m, median_m, transmittance = (sky.new_empty(len(sky)) for _ in range(3))
    out = Rendered(sky.new_empty(sky.shape), depth_m, median_m, transmittance, sigma.new_zeros(sigma.shape))
    inputs = [samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky]
    outputs = [out.rgb, out.depth_m, out.median_m, out.transmittance, out.weights]
    _launch(composite.forward, inputs, outputs, FLOOR=OPACITY_FLOOR)
    return out


def backward(
    samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the derivatives by sigma, rgb and sky."""
    d_sigma, d_rgb, d_sky = sigma.new_zeros(sigma.shape), rgb.new_zeros(rgb.shape), sky.new_empty(sky.shape)
    forward_results = [rendered.depth_m, rendered.transmittance, rendered.weights]
    d_results = [gradients.rgb, gradients.depth_m, gradients.transmittance, gradients.weights, gradients.tau]
    inputs = [samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky, *forward_results, *d_results]
    _launch(composite.backward, inputs, [d_sigma, d_rgb, d_sky], FLOOR=OPACITY_FLOOR)
    return d_sigma, d_rgb, d_sky


def kl(samples: Samples, sigma: Tensor, target: Target, scale: Tensor, d_tau: Tensor) -> Tensor:
    """Return the KL loss (r,), add its gradient to d_tau (m,)."""
    loss = torch.empty_like(target.prior_m)
    _launch(composite.kl, [samples.offsets, sigma, samples.dt_m, samples.t, *target, scale], [loss, d_tau])
    return loss


def sight(samples: Samples, weights: Tensor, target: Target, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""
    loss = torch.empty_like(target.prior_m)
    _launch(composite.sight, [samples.offsets, weights, samples.dt_m, samples.t, *target, scale], [loss, d_weights])
    return loss


def distortion(samples: Samples, weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return the distortion (r,), add its gradient to d_weights (m,)."""
    loss = scale.new_empty(scale.shape)
    _launch(composite.distortion, [samples.offsets, weights, samples.s0, samples.s1, scale], [loss, d_weights])
    return loss


def interlevel(
    samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor, scale: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""
    loss, gradient = scale.new_empty(scale.shape), coarse_weights.new_zeros(coarse_weights.shape)
    fine = [samples.offsets, weights, samples.s0, samples.s1]
    inputs = [*fine, coarse.offsets, coarse_weights, coarse.s0, coarse.s1, scale]
    _launch(composite.interlevel, inputs, [loss, gradient])
    return loss, gradient


def _launch(kernel, inputs: list[Tensor], outputs: list[Tensor], **constants: float) -> None:  # type: ignore[no-untyped-def]
    """Run a kernel over all rays; the first input is the offsets; outputs are contiguous."""
    rays = len(inputs[0]) - 1
    kernel[-(-rays // _RAYS),](*(x.contiguous() for x in inputs), rays, *outputs, **constants, RAYS=_RAYS, num_warps=1)
