"""Losses: colour, depth (four of them), distortion, opacity. Per ray and unreduced; one rule reduces them all.

Reduction: a colour loss is the mean over the rays. A depth loss is the mean over the rays that have a prior, weighted
by confidence where there is one: sum(weight l) / sum(weight). A sparse map and a dense one therefore pull equally
hard with the same --depth-weight, and an empty one gives 0. Nothing here waits for a GPU: what is reduced stays there.

Depth losses, with D the rendered camera-z depth, d the prior's, w the samples' weights, U a unit of length and s the
prior's standard deviation (metres, max(sigma_floor_m, sigma_share * d)):

    mse   ((D - d) / U)^2
    l1    |D - d| / U
    kl    -sum q log w, q the mass of N(d, s) in each sample's interval, normalised to 1 (DS-NeRF, Deng et al.,
          CVPR 2022, eq. 9, with s^2 as the variance and masses instead of densities)
    urf   ((D - d) / U)^2 + sum over t < d - 3s of w^2 + sum over |t - d| <= 3s of (w - mass of N(d, s))^2
          (Rematas et al., CVPR 2022, eq. 6 to 9, targets in units of weight)
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from nerf.kernels import RenderKernels, kernels_for
from nerf.precision import precision
from nerf.types import Gradients, Rays, Rendered, Samples, Target
from nerf.world import here
from priors.errors import expect, expect_choices

DepthLoss = Literal["none", "mse", "l1", "kl", "urf"]
DepthMean = Literal["prior", "all"]
Weigh = Literal["auto", "confidence", "precision"]


SOFT = 0.05
"""Added to the transmittance whose logarithm says how opaque the sky is."""


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class LossConfig:
    """What is minimised."""

    loss: DepthLoss = "l1"
    """Depth loss."""
    depth_weight: float = 0.05
    """Weight of the depth loss beside the colour loss."""
    unit_m: float = 16.0
    """Length by which mse and l1 divide depth errors, metres."""
    sigma_share: float = 0.05
    """Standard deviation of the prior as a share of its depth, for kl and urf."""
    sigma_floor_m: float = 0.1
    """Smallest standard deviation of the prior, metres."""
    depth_mean: DepthMean = "prior"
    """The rays that the depth loss is the mean of: those with a prior, or all, as the study has it (MipNeRF-360,
    Instant-NGP): a sparse map then pulls less than a dense one."""
    by_confidence: bool = True
    """Weight rays by the prior's confidence, the probability that it is right."""
    weigh: Weigh = "auto"
    """What rays count by in the depth loss. confidence: as it is; precision: how exact a value of such a confidence is
    (nerf/precision.py), so that one that is right once in ten times pulls a thirtieth as hard as a sure one (mse: an
    800th); auto: precision where the prior's guesses lie too near, as a completed map's, else confidence."""
    trim: float = 0.05
    """Share of each batch's prior rays, those with the largest depth loss, that is left out."""
    distortion: float = 1e-3
    """Weight of mip-NeRF 360's distortion loss."""
    opacity: float = 0.02
    """Weight of the light that passes rays where the prior has a surface."""
    opacity_power: float = 2.0
    """Power of the prior's confidence with which a ray counts there. 1: a value that is right three times of ten makes
    its ray solid with three tenths of the weight, where most often nothing is; 2: with nine hundredths."""
    sky_opacity: float = 0.001
    """Weight of what stops the light of rays into the sky, where there is a prior; 0: the sky may be solid."""

    BEFORE: ClassVar[Mapping[str, Any]] = {"sky_opacity": 0.0, "trim": 0.0, "opacity_power": 1.0, "weigh": "confidence"}

    def __post_init__(self) -> None:
        expect_choices(self, "")
        for name in ("depth_weight", "sigma_share", "distortion", "opacity", "opacity_power", "sky_opacity"):
            value = getattr(self, name)
            expect(0 <= value < math.inf, _flag(name), value, "0 or more")
        for name in ("unit_m", "sigma_floor_m"):
            value = getattr(self, name)
            expect(0 < value < math.inf, _flag(name), value, "more than 0 m")
        expect(0 <= self.trim < 1, "--trim", self.trim, "a share from 0 to less than 1")

    def of(self, guessed: bool) -> "LossConfig":
        """Return the settings for a prior, `guessed`: whether its guesses lie too near (nerf/guide.py)."""
        return replace(self, weigh="precision" if guessed else "confidence") if self.weigh == "auto" else self


@dataclass(frozen=True, slots=True)
class Losses:
    """The batch's losses, reduced, and what to do about them."""

    terms: dict[str, Tensor]
    """Reduced, unweighted: rgb, depth, distortion, opacity, sky."""
    total: Tensor
    gradients: Gradients
    samples: int
    """How many samples the batch had."""
    each: Tensor
    """(r,) what colour and depth add to the loss of each ray, weighted."""
    rendered: Rendered
    """What they are the losses of."""


def losses(
    config: LossConfig,
    samples: Samples,
    rays: Rays,
    sigma: Tensor,
    rendered: Rendered,
    kernels: RenderKernels | None = None,
) -> Losses:
    """Compute all losses and their gradients by what was rendered; `kernels`: others than the device's fastest.

    Raises:
        ValueError: the rays have no colours.
    """
    if rays.rgb is None:
        raise ValueError("rays without colours cannot be trained on")
    kernels = kernels or kernels_for(sigma.device).render
    gradients = Gradients.zeros(rendered)
    terms, each = {}, torch.zeros_like(rendered.depth_m)
    terms["rgb"] = _colour(rays, rendered, gradients, each)
    weight = prior_weight(config, rays)
    if weight is not None and config.loss != "none":
        prior_m = torch.where(weight > 0, rays.depth_m, 0.0)  # type: ignore[arg-type]
        deviation_m = (config.sigma_share * prior_m).clamp(min=config.sigma_floor_m)
        target = Target(rays.norms, prior_m, deviation_m)
        term = _DepthTerm(config, samples, target, sigma, rendered, kernels)
        counts = precision(config.loss, weight) if config.weigh == "precision" else weight
        terms["depth"] = _depth(term, counts, rays.share, gradients, each)
    terms["opacity"] = _opacity(config, _share(rays, _stopping(config, samples, weight)), rendered, gradients)
    if rays.sky is not None and config.sky_opacity > 0:
        terms["sky"] = _sky(config, _share(rays, rays.sky), rendered, gradients)
    terms["distortion"] = _distortion(config, samples, rays, rendered, (gradients, kernels))
    scales = {"rgb": 1.0, "depth": config.depth_weight, "opacity": config.opacity, "distortion": config.distortion}
    scales["sky"] = config.sky_opacity
    terms = {name: here().total(value) for name, value in terms.items()}
    total = torch.stack([scales[name] * value for name, value in terms.items()]).sum()
    return Losses(terms, total, gradients, samples.used, each, rendered)


def prior_weight(config: LossConfig, rays: Rays) -> Tensor | None:
    """Return how much each ray's prior counts (r,): 0 where it has none; None where no ray can have one."""
    if rays.depth_m is None:
        return None
    valid = (rays.depth_m > 0) & torch.isfinite(rays.depth_m)
    weight = rays.weight if config.by_confidence and rays.weight is not None else torch.ones_like(rays.depth_m)
    return torch.where(valid, weight, 0.0)


def _colour(rays: Rays, rendered: Rendered, gradients: Gradients, each: Tensor) -> Tensor:
    """Reduce the squared colour errors, set their gradients, and add each ray's to `each`."""
    assert rays.rgb is not None
    off = rendered.rgb - rays.rgb
    squared = off * off
    each += squared.mean(1)
    if rays.share is None:
        gradients.rgb.copy_(2 / (off.numel() * here().size) * off)
        return squared.mean() / here().size
    gradients.rgb.copy_(2 / 3 * rays.share[:, None] * off)
    return (rays.share * each).sum()


def _depth(term: "_DepthTerm", weight: Tensor, drawn: Tensor | None, gradients: Gradients, each: Tensor) -> Tensor:
    """Reduce the depth loss, add its gradients, and each ray's loss to `each`.

    Args:
        term: the loss of each ray.
        weight: (r,) how much each ray's prior counts.
        drawn: (r,) each ray's share in a mean, where rays are drawn unevenly.
        gradients: added to.
        each: (r,) added to.
    """
    counted = torch.ones_like(weight) if drawn is None else drawn
    if drawn is not None:
        weight = weight * drawn
    if term.config.trim > 0:
        values = term(torch.zeros_like(weight), Gradients.zeros(term.rendered))
        weight = trimmed(weight, values, term.config.trim)
    total = here().total(counted.sum() if term.config.depth_mean == "all" else weight.sum())
    share = weight / total.clamp(min=1e-12)
    values = term(term.config.depth_weight * share, gradients)
    each += term.config.depth_weight * values
    return (share * values).sum()


def trimmed(weight: Tensor, loss: Tensor, share: float) -> Tensor:
    """Give weight 0 to the `share` of the rays with a weight whose loss is largest; of all processes' rays."""
    has, world = weight > 0, here()
    drop = int(share * int(world.total(has.sum())))
    if drop == 0:
        return weight
    out = world.joined(weight).clone()
    out[world.joined(torch.where(has, loss, -1.0)).topk(drop).indices] = 0
    return out[world.part(len(weight))]


@dataclass(frozen=True, slots=True)
class _DepthTerm:
    """The depth loss of one batch: called with a scale a ray, adds the gradients and returns the losses (r,)."""

    config: LossConfig
    samples: Samples
    target: Target
    sigma: Tensor
    rendered: Rendered
    kernels: RenderKernels

    def __call__(self, scale: Tensor, gradients: Gradients) -> Tensor:
        config, target, kernels = self.config, self.target, self.kernels
        if config.loss == "kl":
            return kernels.kl(self.samples, self.sigma, target, scale, gradients.tau)
        off = torch.where(target.prior_m > 0, self.rendered.depth_m - target.prior_m, 0.0) / config.unit_m
        if config.loss == "l1":
            gradients.depth_m.add_(scale * off.sign() / config.unit_m)
            return off.abs()
        gradients.depth_m.add_(scale * 2 * off / config.unit_m)
        if config.loss == "mse":
            return off * off
        weights, d_weights = self.rendered.weights, gradients.weights
        return off * off + kernels.sight(self.samples, weights, target, scale, d_weights)


def _stopping(config: LossConfig, samples: Samples, weight: Tensor | None) -> Tensor:
    """Return how much each ray should stop its light (r,): those with a prior, or all where there is no prior.

    A ray counts by its prior's confidence, so that a guess in the sky does not make it solid; one without samples
    cannot stop anything and does not count.
    """
    has_samples = samples.offsets[1:] > samples.offsets[:-1]
    if weight is None:
        return has_samples.float()
    return has_samples * torch.where(weight > 0, weight**config.opacity_power, 0.0)


def _share(rays: Rays, weight: Tensor) -> Tensor:
    """Return the shares (r,) of weighted rays in a mean over those that count."""
    if rays.share is None:
        return weight / here().total((weight > 0).sum()).clamp(min=1)
    return weight * rays.share / here().total(rays.share[weight > 0].sum()).clamp(min=1e-12)


def _opacity(config: LossConfig, share: Tensor, rendered: Rendered, gradients: Gradients) -> Tensor:
    """Reduce the light that passes rays which should stop it."""
    gradients.transmittance.add_(config.opacity * share)
    return (share * rendered.transmittance).sum()


def _sky(config: LossConfig, share: Tensor, rendered: Rendered, gradients: Gradients) -> Tensor:
    """Reduce -log(T + SOFT) of rays into the sky: the cross entropy of their opacity with none, softened.

    What is solid there is not pulled at harder than a share T / (T + SOFT) of its optical depth: a pole that the
    sky's mask overlooks is held by its colours.
    """
    passed = rendered.transmittance + SOFT
    gradients.transmittance.sub_(config.sky_opacity * share / passed)
    return -(share * torch.log(passed)).sum()


def _distortion(
    config: LossConfig, samples: Samples, rays: Rays, rendered: Rendered, given: tuple[Gradients, RenderKernels]
) -> Tensor:
    """Reduce the distortion: the mean over the rays."""
    gradients, kernels = given
    share = mean_share(rays.share, samples)
    values = kernels.distortion(samples, rendered.weights, config.distortion * share, gradients.weights)
    whole = max(1, len(share)) * here().size
    return (share * values).sum() if rays.share is not None else values.sum() / whole


def mean_share(share: Tensor | None, samples: Samples) -> Tensor:
    """Return the share (r,) that each ray of a batch, of all processes, has in its mean."""
    rays = len(samples.offsets) - 1
    whole = max(1, rays) * here().size
    return torch.full((rays,), 1 / whole, device=samples.t.device) if share is None else share


def interlevel(
    samples: Samples, rendered: Rendered, coarse: Samples, coarse_rendered: Rendered, share: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Ask a proposal's weights to bound the field's: the mean over rays, and its gradient by the weights (m,).

    sum max(0, w - what the coarse intervals that overlap hold)^2 / w (Barron et al., CVPR 2022, eq. 13); the field's
    own weights are not moved by it. `share` (r,): of the rays in the mean; None: 1 / r.
    """
    scale = mean_share(share, samples)
    kernels = kernels_for(rendered.rgb.device).render
    values, gradient = kernels.interlevel(samples, rendered.weights, coarse, coarse_rendered.weights, scale)
    return here().total((scale * values).sum()), gradient
