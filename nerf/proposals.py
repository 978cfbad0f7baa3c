"""Proposal networks (Barron et al., CVPR 2022): small fields whose weights say where the next samples go.

A round asks a proposal for the density at its samples; the next round's samples follow its weights. The interlevel
loss asks a proposal's weights to bound the field's.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nerf.field import Field, FieldConfig
from nerf.kernels import kernels_for
from nerf.losses import interlevel
from nerf.mlp import MLPConfig
from nerf.roulette import Wheel
from nerf.sample import Sampler, SamplerConfig, guidable
from nerf.types import Gradients, GridConfig, Histogram, Key, Rays, Rendered, Samples

PROPOSAL_GRID = GridConfig(levels=8, log2_size=15, finest=512)
PROPOSAL_WIDTH = 16
PROPOSAL = "proposal"
"""What the names of their parameters begin with."""
ANNEAL_SLOPE, ANNEAL_SHARE = 10.0, 0.2
"""Barron et al., CVPR 2022, section 4; over this share of the fit."""
MARGIN = 0.002
"""By how much a proposal's bins are widened, in s."""
PRIOR_SHARE = 0.5
"""Share of a guided ray's samples after its proposals that the prior places."""


@dataclass(frozen=True, slots=True)
class Round:
    """One proposal round, kept for its backward pass."""

    samples: Samples
    sigma: Tensor
    rendered: Rendered


class Proposals:
    """The proposals of a model, near to the last: none for a family that needs none."""

    def __init__(
        self, counts: tuple[int, ...], sampler: Sampler, device: torch.device, seed: int, anti_aliased: bool
    ) -> None:
        """Make a small field for each of `counts`, its number of candidates a ray; their seeds count up.

        `anti_aliased`: they are asked for the samples' extents, not for points.
        """
        config = FieldConfig(replace(PROPOSAL_GRID, tables=sampler.space.tables), MLPConfig(width=PROPOSAL_WIDTH))
        self.counts, self.sampler, self.anti_aliased = counts, sampler, anti_aliased
        self.fields = [Field(config, device, seed + i) for i in range(len(counts))]
        self._renderer = kernels_for(device).render

    def learn_at(self, step: int, progress: float, every: int) -> bool:
        """Tell whether the proposals learn at a step, from 0: at every one early in a fit, later at one of `every`.

        After the schedule of nerfstudio's proposal networks; as there, they sample in all steps.
        """
        return bool(self.fields) and (progress < ANNEAL_SHARE or (step + 1) % every == 0)

    def named(self) -> dict[str, Field]:
        """Return the small fields by the names that their parameters go by."""
        return {f"{PROPOSAL}{i}": proposal for i, proposal in enumerate(self.fields)}

    def sample(
        self, rays: Rays, config: SamplerConfig, key: Key | None, progress: float
    ) -> tuple[Samples, list[Round]]:
        """Sample rays in rounds; returns the last samples, and the rounds before them.

        Args:
            rays: with the prior depths that may guide them.
            config: how many samples the last ones are, and how the prior guides.
            key: seed and step; None: rendering, the prior guides nothing.
            progress: of the fit, [0, 1]: early on the proposals' weights are flattened.
        """
        share = min(1.0, progress / ANNEAL_SHARE)
        anneal = ANNEAL_SLOPE * share / ((ANNEAL_SLOPE - 1) * share + 1)
        rounds: list[Round] = []
        is_guided = guided(rays, config, key)
        most, each = _last_counts(config, is_guided, shown=key is None)
        counts = [(count, None) for count in self.counts[1:]]
        samples = self.sampler.march(rays, self.counts[0], key)
        for proposal, (count, of_each) in zip(self.fields, [*counts, (most, each)], strict=True):
            cones = self.anti_aliased and rays.pixel
            footprint = self.sampler.space.footprint(samples, rays.pixel) if cones else None
            sigma = proposal.density_forward(samples, footprint)
            rendered = self._renderer.forward(samples, sigma, *_colourless(sigma, len(rays)))
            rounds.append(Round(samples, sigma, rendered))
            weights = rendered.weights
            if is_guided is not None:
                weights = mixed(rays, samples, weights, is_guided, config.reach)
            samples = self.sampler.resample(rays, Histogram(samples, weights, MARGIN, anneal), count, key, of_each)
        return samples, rounds

    def backward(
        self, rounds: list[Round], samples: Samples, rendered: Rendered, share: Tensor | None, wheel: Wheel
    ) -> Tensor:
        """Set the proposals' gradients, by the weights of the field's samples; returns the last interlevel loss.

        `share` (r,): of the rays in the mean; None: 1 / r. `wheel`: which samples go through the backward pass.
        """
        value = rendered.rgb.new_zeros(())
        for proposal, each in zip(self.fields, rounds, strict=True):
            value, d_weights = interlevel(samples, rendered, each.samples, each.rendered, share)
            gradients = replace(Gradients.zeros(each.rendered), weights=d_weights)
            given = each.samples, each.sigma, *_colourless(each.sigma, len(each.rendered.rgb))
            d_sigma, _, _ = self._renderer.backward(*given, each.rendered, gradients)
            proposal.density_backward(*wheel.thinned(d_sigma, (d_sigma * each.sigma).abs()))
        return value


def guided(rays: Rays, config: SamplerConfig, key: Key | None) -> Tensor | None:
    """Tell which rays (r,) the prior guides; None: none, as where views are rendered."""
    if key is None or not config.guide or rays.depth_m is None:
        return None
    return guidable(rays.depth_m, config.unguided, key)


def _last_counts(config: SamplerConfig, is_guided: Tensor | None, shown: bool) -> tuple[int, Tensor | None]:
    """Return how many samples rays get after their proposals: at most, and each (r,) where they differ.

    `shown`: views are rendered.
    """
    others = config.count if config.proposed is None else config.proposed
    if shown and config.render_proposed is not None:
        others = config.render_proposed
    if is_guided is None or others == config.count:
        return others, None
    return max(config.count, others), torch.where(is_guided, config.count, others)


def mixed(rays: Rays, samples: Samples, weights: Tensor, is_guided: Tensor, reach: float) -> Tensor:
    """Mix weights (m,) with the prior: of a guided ray's mass PRIOR_SHARE lies evenly in the prior's band.

    `is_guided` (r,): which rays those are; `reach`: half width of the band, as a share of the prior's depth.
    """
    assert rays.depth_m is not None
    ray = samples.ray[: samples.used].long()
    depth_m = torch.where(is_guided, rays.depth_m, 0.0)[ray]
    t, s0, s1 = (x[: samples.used] for x in (samples.t, samples.s0, samples.s1))
    half_m = samples.dt_m[: samples.used] / (2 * rays.norms[ray])
    inside = (depth_m > 0) & ((t - depth_m).abs() <= reach * depth_m + half_m)
    mass = torch.where(inside, s1 - s0, 0.0)

    def total(x: Tensor) -> Tensor:
        return torch.zeros(len(rays), device=x.device).index_add_(0, ray, x)[ray]

    band, own = total(mass), weights[: samples.used]
    shared = (1 - PRIOR_SHARE) * own / total(own).clamp(min=1e-6) + PRIOR_SHARE * mass / band.clamp(min=1e-12)
    out = weights.clone()
    out[: samples.used] = torch.where(band > 0, shared, own)
    return out


def _colourless(sigma: Tensor, rays: int) -> tuple[Tensor, Tensor]:
    """Return black samples (m, 3) before a black sky (r, 3)."""
    return torch.zeros(len(sigma), 3, device=sigma.device), torch.zeros(rays, 3, device=sigma.device)
