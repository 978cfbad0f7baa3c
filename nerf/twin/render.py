"""Volume rendering and its losses in plain torch: the readable twin, with autograd, in any precision, on any device.

Packed samples are spread to (rays, most samples of a ray), padding weighs nothing. Slow, and memory-hungry.
"""

import torch
from torch import Tensor

from nerf.types import (
    INTERLEVEL_SOFT,
    LEAST_MASS,
    LEAST_OPACITY,
    OPACITY_FLOOR,
    SIGHT_DEVIATIONS,
    Rendered,
    Samples,
    Target,
)


def spread(samples: Samples, packed: Tensor) -> Tensor:
    """Spread packed values (m, ...) to (r, s, ...), zeros where a ray has fewer than s samples."""
    rays = len(samples.offsets) - 1
    ray = samples.ray[: samples.used].long()
    place = torch.arange(samples.used, device=packed.device) - samples.offsets[ray]
    most = int(place.max()) + 1 if samples.used else 1
    out = torch.zeros(rays, most, *packed.shape[1:], dtype=packed.dtype, device=packed.device)
    return out.index_put((ray, place), packed[: samples.used])


def gather(samples: Samples, padded: Tensor) -> Tensor:
    """Undo `spread`: (r, s) to (m,), zeros in the padding."""
    ray = samples.ray[: samples.used].long()
    place = torch.arange(samples.used, device=padded.device) - samples.offsets[ray]
    out = torch.zeros(len(samples.ray), dtype=padded.dtype, device=padded.device)
    return torch.cat([padded[ray, place], out[samples.used :]])


def render(samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
    """Composite samples near to far."""
    tau = spread(samples, sigma * samples.dt_m.to(sigma))
    t = spread(samples, samples.t.to(sigma))
    after = torch.exp(-torch.cumsum(tau, 1))
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    weights = before * -torch.expm1(-tau)
    transmittance = after[:, -1]
    opacity = -torch.expm1(-tau.sum(1))
    colour = (weights[..., None] * spread(samples, rgb)).sum(1) + transmittance[:, None] * sky
    depth_m = (weights * t).sum(1) / opacity.clamp(min=OPACITY_FLOOR)
    crosses = (before > 0.5) & (after <= 0.5)
    median_m = (crosses * t).sum(1)
    return Rendered(colour, depth_m, median_m, transmittance, gather(samples, weights))


def masses(samples: Samples, target: Target) -> Tensor:
    """Return the mass of N(prior, deviation) in each sample's interval: (r, s)."""
    norms, prior_m, deviation_m = target
    half = spread(samples, samples.dt_m.to(prior_m)) / (2 * norms[:, None])
    t = spread(samples, samples.t.to(prior_m))
    low, high = (t - half - prior_m[:, None]), (t + half - prior_m[:, None])
    root = 0.5**0.5 / deviation_m[:, None]
    return 0.5 * (torch.erf(high * root) - torch.erf(low * root))


def kl(samples: Samples, sigma: Tensor, target: Target) -> Tensor:
    """Return the KL loss (r,)."""
    return kl_of_tau(samples, sigma * samples.dt_m.to(sigma), target)


def kl_of_tau(samples: Samples, tau: Tensor, target: Target) -> Tensor:
    """Return the KL loss (r,) from optical depths (m,)."""
    tau = spread(samples, tau)
    mass = masses(samples, target)
    total = mass.sum(1, keepdim=True)
    usable = (total[:, 0] >= LEAST_MASS) & (target.prior_m > 0)
    q = mass / torch.where(usable[:, None], total, 1.0)
    log_w = torch.log((-torch.expm1(-tau)).clamp(min=LEAST_OPACITY)) - (torch.cumsum(tau, 1) - tau)
    return torch.where(usable, -(q * log_w).sum(1), 0.0)


def sight(samples: Samples, weights: Tensor, target: Target) -> Tensor:
    """Return URF's line-of-sight loss (r,)."""
    w = spread(samples, weights)
    t = spread(samples, samples.t.to(weights))
    reach = SIGHT_DEVIATIONS * target.deviation_m[:, None]
    near = (t - target.prior_m[:, None]).abs() <= reach
    mass = torch.where(near, masses(samples, target), 0.0)
    counts = t <= target.prior_m[:, None] + reach
    off = torch.where(counts, w - mass, 0.0)  # not a product with 0: NaN behind the surface does not count
    return torch.where(target.prior_m > 0, (off**2).sum(1), 0.0)


def distortion(samples: Samples, weights: Tensor) -> Tensor:
    """Return the distortion (r,), straight from its double sum."""
    w, s0, s1 = (spread(samples, x.to(weights)) for x in (weights, samples.s0, samples.s1))
    middle = (s0 + s1) / 2
    apart = (middle[:, :, None] - middle[:, None, :]).abs()
    return (w[:, :, None] * w[:, None, :] * apart).sum((1, 2)) + (w * w * (s1 - s0)).sum(1) / 3


def interlevel(samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor) -> Tensor:
    """Return the interlevel loss (r,); fine weights are taken as they are, only the coarse ones learn."""
    w, s0, s1 = (spread(samples, x.detach().to(coarse_weights)) for x in (weights, samples.s0, samples.s1))
    bound, low, high = (spread(coarse, x.to(coarse_weights)) for x in (coarse_weights, coarse.s0, coarse.s1))
    meets = (low[:, None, :] < s1[:, :, None]) & (high[:, None, :] > s0[:, :, None])
    over = (w - (meets * bound[:, None, :]).sum(2)).clamp(min=0)
    return (over**2 / (w + INTERLEVEL_SOFT)).sum(1)
