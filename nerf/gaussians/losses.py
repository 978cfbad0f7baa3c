"""Losses of a whole view of Gaussians, and their derivatives by what was rasterised.

Colour: (1 - dssim) L1 + dssim (1 - SSIM). Depth: the four of nerf/losses.py with its reduction, mse and l1 on every
pixel, kl and urf on pixels that are drawn, since they look at the single Gaussians of a ray: each stands for the
interval that ends half way to its neighbours, the first begins at the camera. Opacity and sky: as there.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from nerf.gaussians.shot import Shot
from nerf.gaussians.types import Contributions, Rasterised, ViewGradients
from nerf.kernels import kernels_for
from nerf.losses import SOFT, LossConfig, trimmed
from nerf.types import OPACITY_FLOOR, Key, Samples, Target, padded_count

DEPTH_SHARE = 8.0
"""How much more a depth loss weighs than in other families: L1 and SSIM are so much larger than squared errors."""
FARTHEST_M = 1000.0
"""Where the interval of a ray's last Gaussian ends at least, metres."""
LEAST_M = 1e-6
"""Least length of an interval, metres."""


@dataclass
class ViewLosses:
    """Losses of a view so far, unweighted, their weighted sum, and derivatives."""

    d_depth_sum: Tensor
    """(h, w)"""
    d_opacity: Tensor
    """(h, w)"""
    total: Tensor
    terms: dict[str, Tensor] = field(default_factory=dict)
    made: Contributions | None = None
    """Those that the next two are by, (m,)."""
    d_weights: Tensor | None = None
    d_tau: Tensor | None = None

    def add(self, name: str, value: Tensor, weight: float) -> None:
        """Note a loss."""
        self.terms[name] = value
        self.total = self.total + weight * value

    def pull_depth(self, seen: Rasterised, d_depth: Tensor) -> None:
        """Add the derivatives by what the expected depth is made of, from those by itself, (h, w)."""
        whole = seen.opacity.clamp(min=OPACITY_FLOOR)
        self.d_depth_sum += d_depth / whole
        self.d_opacity -= torch.where(seen.opacity > OPACITY_FLOOR, d_depth * seen.depth_sum / (whole * whole), 0.0)

    def gradients(self, d_rgb: Tensor) -> ViewGradients:
        """Return what the rasteriser's way back takes."""
        return ViewGradients(d_rgb, self.d_depth_sum, self.d_opacity, self.made, self.d_weights, self.d_tau)


def geometry_losses(rules: LossConfig, shot: Shot, seen: Rasterised, rays: int, key: Key) -> ViewLosses:
    """Return all losses but the colour's; `rays`: how many pixels kl and urf look at, `key`: draws them."""
    zeros = torch.zeros_like(seen.opacity)
    out = ViewLosses(zeros, zeros.clone(), zeros.new_zeros(()))
    if shot.weight is not None and rules.loss != "none":
        by_pixel = rules.loss in ("mse", "l1")
        value = _by_pixel(rules, shot, seen, out) if by_pixel else _by_ray(rules, shot, seen, out, (rays, key))
        out.add("depth", value, DEPTH_SHARE * rules.depth_weight)
    passes = 1 - seen.opacity
    if shot.weight is not None and rules.opacity > 0:
        share = shot.weight / (shot.weight > 0).sum().clamp(min=1)
        out.d_opacity -= rules.opacity * share
        out.add("opacity", (share * passes).sum(), rules.opacity)
    if shot.sky is not None and rules.sky_opacity > 0:
        share = shot.sky / shot.sky.sum().clamp(min=1)
        out.d_opacity += rules.sky_opacity * share / (passes + SOFT)
        out.add("sky", -(share * torch.log(passes + SOFT)).sum(), rules.sky_opacity)
    return out


def _by_pixel(rules: LossConfig, shot: Shot, seen: Rasterised, out: ViewLosses) -> Tensor:
    """Reduce mse or l1 of every pixel's expected depth, and add its derivatives."""
    assert shot.depth_m is not None and shot.weight is not None
    off = torch.where(shot.weight > 0, seen.depth_m(OPACITY_FLOOR) - shot.depth_m, 0.0) / rules.unit_m
    values, slope = (off.abs(), off.sign()) if rules.loss == "l1" else (off * off, 2 * off)
    share = _share(rules, shot.weight.flatten(), values.flatten()).view_as(values)
    out.pull_depth(seen, DEPTH_SHARE * rules.depth_weight / rules.unit_m * share * slope)
    return (share * values).sum()


def _share(rules: LossConfig, weight: Tensor, values: Tensor) -> Tensor:
    """Return what each value (r,) of a weight (r,) is of the mean: nerf/losses.py has the rule."""
    kept = trimmed(weight, values, rules.trim) if rules.trim > 0 else weight
    total = torch.tensor(float(len(kept))) if rules.depth_mean == "all" else kept.sum()
    return kept / total.clamp(min=1e-12)


def _by_ray(rules: LossConfig, shot: Shot, seen: Rasterised, out: ViewLosses, drawn: tuple[int, Key]) -> Tensor:
    """Reduce kl or urf of some pixels that have a prior, and add its derivatives."""
    assert shot.depth_m is not None and shot.weight is not None
    pixels = _draw(shot.weight, *drawn)
    if not len(pixels):
        return torch.zeros((), device=pixels.device)
    splat, render = kernels_for(pixels.device).splat, kernels_for(pixels.device).render
    made = splat.contributions(seen, pixels)
    prior_m, weight = shot.depth_m.flatten()[pixels], shot.weight.flatten()[pixels]
    deviation_m = (rules.sigma_share * prior_m).clamp(min=rules.sigma_floor_m)
    target = Target(torch.ones_like(prior_m), prior_m, deviation_m)  # intervals are metres of depth
    samples, count = intervals(made), len(made.weights)
    padding = len(samples.t) - count

    def value(scale: Tensor, gradient: Tensor) -> Tensor:
        if rules.loss == "urf":
            return render.sight(samples, _padded(made.weights, padding), target, scale, gradient)
        tau = -torch.log1p(-made.alphas)
        sigma = _padded(tau, padding) / samples.dt_m.clamp(min=LEAST_M)
        return render.kl(samples, sigma, target, scale, gradient)

    values = value(torch.zeros_like(prior_m), torch.zeros_like(samples.t))
    off = torch.zeros_like(prior_m)
    if rules.loss == "urf":
        off = (seen.depth_m(OPACITY_FLOOR).flatten()[pixels] - prior_m) / rules.unit_m
        values = values + off * off
    share = _share(rules, weight, values)
    scale, gradient = DEPTH_SHARE * rules.depth_weight * share, torch.zeros_like(samples.t)
    value(scale, gradient)
    out.made = made
    if rules.loss == "kl":
        out.d_tau = gradient[:count]
    else:
        out.d_weights = gradient[:count]
        d_depth = torch.zeros_like(seen.opacity).flatten()
        d_depth[pixels] = scale * 2 * off / rules.unit_m
        out.pull_depth(seen, d_depth.view_as(seen.opacity))
    return (share * values).sum()


def intervals(made: Contributions) -> Samples:
    """Return the stretches of the rays, in metres of depth, that single Gaussians stand for, padded."""
    t, count = made.depths_m, len(made.depths_m)
    first, last = (torch.zeros(count, dtype=torch.bool, device=t.device) for _ in range(2))
    starts, ends = made.offsets[:-1], made.offsets[1:]
    held = ends > starts
    first[starts[held]], last[ends[held] - 1] = True, True
    middle = (t[1:] + t[:-1]) / 2
    low = torch.cat([t[:1] * 0, middle])
    high = torch.cat([middle, t[-1:]])
    low = torch.where(first, 0.0, low)
    high = torch.where(last, t.clamp(min=0) + FARTHEST_M, high)
    length = (high - low).clamp(min=LEAST_M)
    ray = torch.repeat_interleave(torch.arange(len(starts), device=t.device), ends - starts).int()
    padding = padded_count(count) - count
    flat = torch.zeros(padded_count(count), device=t.device)
    t, length = _padded(low + length / 2, padding), _padded(length, padding)
    table = torch.zeros(len(flat), dtype=torch.int32, device=flat.device)
    rays = torch.cat([ray, torch.full((padding,), -1, dtype=torch.int32, device=flat.device)])
    return Samples(made.offsets, rays, t, length, flat, flat, flat[:, None].expand(-1, 3), table, count)


def _padded(values: Tensor, padding: int) -> Tensor:
    return torch.cat([values, values.new_zeros(padding)])


def _draw(weight: Tensor, count: int, key: Key) -> Tensor:
    """Draw pixels (r,) int64 that have a prior: all where there are no more than `count`."""
    having = torch.nonzero(weight.flatten() > 0).flatten()
    if len(having) <= count:
        return having
    random = np.random.Generator(np.random.Philox(key=list(key)))
    chosen = np.sort(random.choice(len(having), count, replace=False))
    return having[torch.from_numpy(chosen).to(having.device)]
