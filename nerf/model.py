"""A model: a family's space, grid, networks and sky, and how rays go through them, forward and back."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from nerf import fields
from nerf.field import Field, FieldConfig
from nerf.kernels import kernels_for
from nerf.losses import LossConfig, Losses, interlevel, losses
from nerf.mlp import NetworkConfig
from nerf.occupancy import Occupancy
from nerf.sample import guidable, guided, march, resample
from nerf.sky import Sky, SkyConfig
from nerf.space import Space
from nerf.types import Gradients, GridConfig, Key, Rays, Rendered, Samples

PROPOSAL_GRID = GridConfig(levels=8, log2_size=15, finest=512)
ANNEAL_SLOPE, ANNEAL_SHARE = 10.0, 0.2  # Barron et al., CVPR 2022, section 4; over this share of the fit
MARGIN = 0.002  # by which proposal bins are widened, in s
LED = 0.5  # share of a guided ray's samples after its proposals that the prior places


@dataclass(frozen=True)
class SamplerConfig:
    """How many samples rays get, and what they skip."""

    count: int = 32
    """Samples of a ray that the prior guides, and of a ray after its proposals."""
    free: int = 64
    """Candidates of a ray without a prior; those in empty cells are dropped."""
    render: int = 256
    """Candidates of a ray when views are rendered."""
    guide: bool = True
    """Put a ray's samples around its prior depth."""
    carve: bool = True
    """Empty the space in front of the prior's surfaces before the first step."""
    reach: float = 0.12
    """Half width of the band of samples around the prior, as a share of its depth."""
    unguided: float = 0.03
    """Share of the rays with a prior that ignore it: gross errors of a prior are found by them."""
    trust: float = 0.2
    """Prior values of less confidence than this carve and guide nothing; the losses weigh them as they do all."""


@dataclass(frozen=True)
class ModelConfig:
    """What is trained."""

    family: str = "ngp"
    """Which family of fields: ngp, mip360 or nerfpp."""
    log2_size: int = 17
    """Rows of the hash grid's levels, as a power of two."""
    finest: int = 2048
    """Cells along an axis of the finest level."""
    width: int = 64
    """Neurons of the hidden layers."""
    sampler: SamplerConfig = field(default_factory=SamplerConfig)


@dataclass(frozen=True, slots=True)
class _Proposed:
    """One proposal round, kept for its backward pass."""

    samples: Samples
    sigma: Tensor
    rendered: Rendered


class Model:
    """The trained thing: everything a checkpoint holds."""

    def __init__(
        self, config: ModelConfig, space: Space, occupancy: Occupancy, seed: int = 0, device: torch.device | str = "cpu"
    ) -> None:
        self.config, self.space, self.occupancy = config, space, occupancy
        self.family = fields.family(config.family)
        grid = GridConfig(log2_size=config.log2_size, finest=config.finest, tables=space.tables)
        self._render = kernels_for(torch.device(device)).render
        self.field = Field(FieldConfig(grid, NetworkConfig(width=config.width)), device, seed)
        self.sky = Sky(SkyConfig(), device)
        proposal = FieldConfig(replace(PROPOSAL_GRID, tables=space.tables), NetworkConfig(width=16))
        self.proposals = [Field(proposal, device, seed + 1 + i) for i in range(len(self.family.proposals))]

    @property
    def device(self) -> torch.device:
        """Where it lives."""
        return self.field.device

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        parts: dict[str, Field | Sky] = {"field": self.field, "sky": self.sky}
        parts.update({f"proposal{i}": proposal for i, proposal in enumerate(self.proposals)})
        return {f"{part}.{name}": tensor for part, made in parts.items() for name, tensor in made.parameters().items()}

    def copies(self) -> dict[str, Tensor]:
        """Return the rounded copies of parameters that the kernels read, by the parameters' names."""
        parts = {"field": self.field} | {f"proposal{i}": p for i, p in enumerate(self.proposals)}
        return {f"{part}.{name}": tensor for part, made in parts.items() for name, tensor in made.copies().items()}

    def train(self, rays: Rays, config: LossConfig, key: Key, progress: float) -> Losses:
        """Go forward and back with a batch; gradients are left in the parameters' `.grad`."""
        samples, proposed = self._sample(rays, key, progress)
        units = rays.units
        sigma, rgb = self.field.forward(samples, units, self._footprint(rays, samples))
        sky = self.sky.forward(units)
        rendered = self._render.forward(samples, sigma, rgb, sky)
        found = losses(config, samples, rays, sigma, rendered)
        d_sigma, d_rgb, d_sky = self._render.backward(samples, sigma, rgb, sky, rendered, found.gradients)
        self.field.backward(d_sigma, d_rgb)
        self.sky.backward(d_sky)
        for proposal, round_ in zip(self.proposals, proposed, strict=True):
            found.terms["interlevel"] = self._teach(proposal, round_, samples, rendered)
        self.occupancy.observe(samples, sigma)
        return found

    def look(self, rays: Rays) -> Rendered:
        """Render rays without learning."""
        if self.proposals:
            samples, _ = self._sample(rays, None, 1.0)
        else:
            samples = march(rays, self.space, self.occupancy, count=self.config.sampler.render)
        sigma, rgb = self.field.forward(samples, rays.units, self._footprint(rays, samples))
        return self._render.forward(samples, sigma, rgb, self.sky.forward(rays.units))

    def density(self, u: Tensor, table: Tensor) -> Tensor:
        """Return density (m,), 1/m, at places u (m, 3): what the occupancy grid asks."""
        return self.field.density(u, table)

    def _sample(self, rays: Rays, key: Key | None, progress: float) -> tuple[Samples, list[_Proposed]]:
        sampler, space, occupancy = self.config.sampler, self.space, self.occupancy
        rays = self._trusted(rays)
        if not self.proposals:
            if sampler.guide and rays.depth_m is not None:
                options = {"reach": sampler.reach, "unguided": sampler.unguided}
                made = guided(rays, space, occupancy, count=sampler.count, free=sampler.free, key=key, **options)
                return made, []
            return march(rays, space, occupancy, count=sampler.free, key=key), []
        share = min(1.0, progress / ANNEAL_SHARE)
        anneal = ANNEAL_SLOPE * share / ((ANNEAL_SLOPE - 1) * share + 1)
        rounds: list[_Proposed] = []
        samples = march(rays, space, occupancy, count=self.family.proposals[0], key=key)
        counts = [*self.family.proposals[1:], sampler.count]
        for proposal, count in zip(self.proposals, counts, strict=True):
            footprint = self._footprint(rays, samples)
            sigma = proposal.density(samples.u, samples.table, footprint, keep=key is not None)
            clear = torch.zeros(len(rays), 3, device=sigma.device)
            colourless = torch.zeros(len(sigma), 3, device=sigma.device)
            rendered = self._render.forward(samples, sigma, colourless, clear)
            rounds.append(_Proposed(samples, sigma, rendered))
            weights = rendered.weights if key is None else self._led(rays, samples, rendered.weights, key)
            options = {"margin": MARGIN, "anneal": anneal}
            samples = resample(rays, space, samples, weights, count=count, occupancy=occupancy, key=key, **options)
        return samples, rounds

    def _trusted(self, rays: Rays) -> Rays:
        """Return the rays without those prior values that are more likely wrong than samplers can stand."""
        if rays.depth_m is None or rays.weight is None:
            return rays
        return replace(rays, depth_m=torch.where(rays.weight >= self.config.sampler.trust, rays.depth_m, 0.0))

    def _led(self, rays: Rays, samples: Samples, weights: Tensor, key: Key) -> Tensor:
        """Mix a proposal's weights (m,) with the prior: of a guided ray's mass, LED lies evenly in the prior's band."""
        sampler = self.config.sampler
        if not sampler.guide or rays.depth_m is None:
            return weights
        led = guidable(rays.depth_m, sampler.unguided, key)
        ray = samples.ray[: samples.used].long()
        depth_m = torch.where(led, rays.depth_m, 0.0)[ray]
        t, s0, s1 = (x[: samples.used] for x in (samples.t, samples.s0, samples.s1))
        half_m = samples.dt_m[: samples.used] / (2 * rays.norms[ray])
        inside = (depth_m > 0) & ((t - depth_m).abs() <= sampler.reach * depth_m + half_m)
        mass = torch.where(inside, s1 - s0, 0.0)

        def total(x: Tensor) -> Tensor:
            return torch.zeros(len(rays), device=x.device).index_add_(0, ray, x)[ray]

        band, own = total(mass), weights[: samples.used]
        mixed = (1 - LED) * own / total(own).clamp(min=1e-6) + LED * mass / band.clamp(min=1e-12)
        out = weights.clone()
        out[: samples.used] = torch.where(band > 0, mixed, own)
        return out

    def _teach(self, proposal: Field, round_: _Proposed, samples: Samples, rendered: Rendered) -> Tensor:
        """Move a proposal towards bounding the field's weights; returns the interlevel loss."""
        value, d_weights = interlevel(samples, rendered, round_.samples, round_.rendered)
        gradients = replace(Gradients.zeros(round_.rendered), weights=d_weights)
        clear = torch.zeros_like(round_.rendered.rgb)
        colourless = torch.zeros(len(round_.sigma), 3, device=round_.sigma.device)
        given = round_.samples, round_.sigma, colourless, clear
        d_sigma, _, _ = self._render.backward(*given, round_.rendered, gradients)
        proposal.density_backward(d_sigma)
        return value

    def _footprint(self, rays: Rays, samples: Samples) -> Tensor | None:
        """Return the samples' standard deviations across the ray (m,), in units of u; None where points will do.

        A pixel is as wide as a cone of standard deviation t pixel / sqrt(12) (Barron et al., ICCV 2021, eq. 8).
        """
        if not self.family.anti_aliased or rays.pixel == 0:
            return None
        return samples.t * (rays.pixel / 12**0.5) / self.space.stretch_m(samples.u, samples.table)
