"""The renderer on devices without kernels of their own: the twin and its autograd."""

from collections.abc import Callable

import torch
from torch import Tensor

from nerf.twin import render as twin
from nerf.twin.sky import look as look
from nerf.twin.sky import paint as paint
from nerf.types import Gradients, Rendered, Samples, Target


def forward(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite samples near to far."""
    return twin.render(samples, sigma, rgb, sky)


def backward(
    samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the derivatives by sigma, rgb and sky: the twin once more, under autograd."""
    with torch.enable_grad():
        inputs = [x.detach().requires_grad_() for x in (sigma, rgb, sky)]
        again = twin.render(samples, *inputs)
        outputs = (again.rgb, again.depth_m, again.transmittance, again.weights, inputs[0] * samples.dt_m)
        d_outputs = (gradients.rgb, gradients.depth_m, gradients.transmittance, gradients.weights, gradients.tau)
        d_sigma, d_rgb, d_sky = torch.autograd.grad(outputs, inputs, d_outputs)
    return d_sigma, d_rgb, d_sky


def kl(samples: Samples, sigma: Tensor, target: Target, scale: Tensor, d_tau: Tensor) -> Tensor:
    """Return the KL loss (r,), add its gradient to d_tau (m,)."""
    tau = sigma * samples.dt_m
    return _differentiate(lambda x: twin.kl_of_tau(samples, x, target), tau, scale, d_tau)


def sight(samples: Samples, weights: Tensor, target: Target, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""
    return _differentiate(lambda x: twin.sight(samples, x, target), weights, scale, d_weights)


def distortion(samples: Samples, weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return the distortion (r,), add its gradient to d_weights (m,)."""
    return _differentiate(lambda x: twin.distortion(samples, x), weights, scale, d_weights)


def interlevel(
    samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor, scale: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""
    gradient = torch.zeros_like(coarse_weights)
    loss = _differentiate(lambda x: twin.interlevel(samples, weights, coarse, x), coarse_weights, scale, gradient)
    return loss, gradient


def _differentiate(loss: Callable[[Tensor], Tensor], at: Tensor, scale: Tensor, gradient: Tensor) -> Tensor:
    with torch.enable_grad():
        inputs = at.detach().requires_grad_()
        value = loss(inputs)
        gradient.add_(torch.autograd.grad((value * scale).sum(), inputs)[0])
    return value.detach()
