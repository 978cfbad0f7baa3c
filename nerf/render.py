"""Volume rendering of packed samples: colour, depth, opacity, and the way back."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.samples import Samples

OPACITY_FLOOR = 1e-3
"""Expected depth is divided by the opacity, or by this where a ray is clearer."""


@dataclass(frozen=True, slots=True)
class Rendered:
    """What r rays see."""

    rgb: Tensor
    """(r, 3) colour, the sky behind everything."""
    depth_m: Tensor
    """(r,) expected camera-z depth of what is not sky, metres: sum(w t) / max(opacity, OPACITY_FLOOR)."""
    median_m: Tensor
    """(r,) camera-z depth at which half of the light is stopped; 0 where it never is."""
    transmittance: Tensor
    """(r,) share of the light that comes from the sky."""
    weights: Tensor
    """(m,) share of the ray's light that each sample stops."""


@dataclass(frozen=True, slots=True)
class Gradients:
    """Derivatives of the loss by what was rendered."""

    rgb: Tensor
    """(r, 3)"""
    depth_m: Tensor
    """(r,)"""
    transmittance: Tensor
    """(r,)"""
    weights: Tensor
    """(m,)"""
    tau: Tensor
    """(m,) by the optical depths themselves, for losses of log w (exact where w underflows)."""

    @classmethod
    def zeros(cls, rendered: Rendered) -> "Gradients":
        """Return gradients of zero."""
        like = torch.zeros_like
        flat = like(rendered.weights)
        return cls(like(rendered.rgb), like(rendered.depth_m), like(rendered.depth_m), flat, flat.clone())


def render(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite samples near to far.

    Args:
        samples: r rays' samples.
        sigma: (m,) density, 1/m.
        rgb: (m, 3) colour.
        sky: (r, 3) what is behind.

    Formula: w = T (1 - exp(-sigma dt)), T the product of exp(-sigma dt) before (Max, TVCG 1995).
    """
    from nerf.kernels import renderer_for

    return renderer_for(sigma.device).render(samples, sigma, rgb, sky)


def backward(
    samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the loss's derivatives by sigma (m,), rgb (m, 3) and sky (r, 3)."""
    from nerf.kernels import renderer_for

    return renderer_for(sigma.device).backward(samples, sigma, rgb, sky, rendered, gradients)
