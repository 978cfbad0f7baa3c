"""The renderer on the CPU: tensors to the compiled loops and back, without copies."""

import torch
from torch import Tensor

from nerf.kernels import composite
from nerf.render import OPACITY_FLOOR, Gradients, Rendered
from nerf.samples import Samples


def render(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite; see nerf.render.render."""
    rays = len(samples.offsets) - 1
    each = torch.empty(3, rays)
    out = Rendered(torch.empty(rays, 3), each[0], each[1], each[2], torch.empty_like(sigma))
    filled = (out.rgb, out.depth_m, out.median_m, out.transmittance, out.weights)
    arrays = (samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky)
    composite.forward(*map(_view, arrays), OPACITY_FLOOR, *map(_view, filled))
    return out


def backward(
    samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
) -> tuple[Tensor, Tensor, Tensor]:
    """Differentiate; see nerf.render.backward."""
    found = torch.empty_like(sigma), torch.empty_like(rgb), torch.empty_like(sky)
    arrays = (samples.offsets, sigma, rgb, samples.t, samples.dt_m, sky)
    made = (rendered.depth_m, rendered.transmittance, rendered.weights)
    given = (gradients.rgb, gradients.depth_m, gradients.transmittance, gradients.weights, gradients.tau)
    composite.backward(*map(_view, arrays), OPACITY_FLOOR, *map(_view, (*made, *given, *found)))
    return found


def kl(
    samples: Samples, sigma: Tensor, norms: Tensor, prior_m: Tensor, deviation_m: Tensor, scale: Tensor, d_tau: Tensor
) -> Tensor:
    """Return the KL loss (r,), add its gradient to d_tau (m,)."""
    loss = torch.empty_like(prior_m)
    arrays = (samples.offsets, sigma, samples.dt_m, samples.t, norms, prior_m, deviation_m, scale, loss, d_tau)
    composite.kl(*map(_view, arrays))
    return loss


def sight(
    samples: Samples,
    weights: Tensor,
    norms: Tensor,
    prior_m: Tensor,
    deviation_m: Tensor,
    scale: Tensor,
    d_weights: Tensor,
) -> Tensor:
    """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""
    loss = torch.empty_like(prior_m)
    arrays = (samples.offsets, weights, samples.dt_m, samples.t, norms, prior_m, deviation_m, scale, loss, d_weights)
    composite.sight(*map(_view, arrays))
    return loss


def distortion(samples: Samples, weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
    """Return the distortion (r,), add its gradient to d_weights (m,)."""
    loss = torch.zeros(len(scale))
    arrays = (samples.offsets, weights, samples.s0, samples.s1, scale, loss, d_weights)
    composite.distortion(*map(_view, arrays))
    return loss


def interlevel(
    samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor, scale: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""
    loss, d_coarse = torch.empty(len(scale)), torch.empty_like(coarse_weights)
    fine = (samples.offsets, weights, samples.s0, samples.s1)
    arrays = (*fine, coarse.offsets, coarse_weights, coarse.s0, coarse.s1, scale, loss, d_coarse)
    composite.interlevel(*map(_view, arrays))
    return loss, d_coarse


def _view(tensor: Tensor):  # type: ignore[no-untyped-def]
    """Return the tensor's memory as an array; the loops want it contiguous."""
    return tensor.contiguous().numpy()
