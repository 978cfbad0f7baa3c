"""Volume rendering model: rays go through a hash grid, networks and a sky, in one space.

The study's three families are three settings of it. Samples are drawn where the occupancy grid, the prior and the
proposals say; field, renderer and losses are the same for all.
"""

import math
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from nerf import roulette
from nerf.config import MOST_CELLS, FitConfig, ModelConfig
from nerf.field import Field, FieldConfig
from nerf.gaussians.config import GaussianConfig
from nerf.kernels import kernels_for
from nerf.learned import Learned
from nerf.losses import LossConfig, Losses, losses, prior_weight
from nerf.mlp import MLPConfig
from nerf.model import StepResult
from nerf.occupancy import Occupancy
from nerf.optimise import Optimiser
from nerf.proposals import PROPOSAL, Proposals, Round
from nerf.ray_appearance import numbers
from nerf.roulette import Wheel
from nerf.sample import Sampler
from nerf.scene import Pixels, Scene, view_rays
from nerf.sky import Sky, SkyConfig
from nerf.space import Kind, Space
from nerf.state import copy_into, joined, under
from nerf.types import GridConfig, Key, Rays, Rendered, RenderedView, Samples
from nerf.walk import in_front, walk
from nerf.world import add_up, here
from priors.machine import threads
from priors.records import restore
from priors.types import Camera, Matrix

OCCUPANCY_EVERY = 16
"""Steps from one look at the occupancy grid's cells to the next."""
RENDER_RAYS = 8192
"""Rays that are rendered at once: more need more memory and are no faster."""


class Trainable(Protocol):
    """A part of a model."""

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""


@dataclass(frozen=True)
class VolumetricFamily:
    """What makes a family; everything else is shared."""

    space: Kind
    """How the world is folded into the grid."""
    proposals: tuple[int, ...] = ()
    """Candidates per ray of each proposal round before the field's own samples; none: the occupancy grid alone."""
    anti_aliased: bool = False
    """Ask the grid for a sample's extent, not for a point: levels finer than a pixel's cone fade."""
    distortion: float = 1.0
    """How much more the distortion loss weighs than usual."""
    rays_growth: float = 1.0
    """How many times as many rays a step has when a fit ends as when it begins, where nobody says and there is a prior.
    Colours alone lose by it: their rays cost more, so that fewer steps are left."""

    unread: ClassVar[tuple[str, ...]] = tuple(
        f"model.gaussians.{setting.name}" for setting in fields(GaussianConfig) if setting.name != "appearance"
    )
    aligns: ClassVar[bool] = True
    """A prior's scales and shifts can be learned with the field."""
    shares: ClassVar[bool] = True
    """Several processes can fit one model together."""

    def start(self, scene: Scene, config: FitConfig, device: str) -> "VolumetricModel":
        """Make an untrained model around a scene, carved where the scene has a prior."""
        space, sampler = Space.along(scene.path, self.space), config.model.sampler
        if sampler.carve and scene.depth_m is not None:
            scene = scene if sampler.carve_sky else replace(scene, sky=None)
            occupancy = Occupancy.carve(space, scene, trust=sampler.trust, device=device)
        else:
            occupancy = Occupancy(space, device=device)
        return self._around(occupancy, scene, config, config.model.gaussians.appearance)

    def go_on(self, scene: Scene, config: FitConfig, record: dict[str, Any], device: str) -> "VolumetricModel":
        """Make a model in a checkpoint's own space, which an earlier version may have laid otherwise.

        It learns the frames' colours only where the checkpoint's does.
        """
        occupancy = Occupancy(restore(Space, record["space"]), device=device)
        return self._around(occupancy, scene, config, record.get("appearance", False))

    def _around(self, occupancy: Occupancy, scene: Scene, config: FitConfig, appearance: bool) -> "VolumetricModel":
        """Make a model around an occupancy grid."""
        learned = Learned.of(scene, config, occupancy.kept.device, appearance)
        return VolumetricModel(config.model, self, occupancy, config.seed, learned)

    def open(
        self, config: ModelConfig, record: dict[str, Any], state: dict[str, Tensor], device: str
    ) -> "VolumetricModel":
        """Make a model again of what a checkpoint holds."""
        space = restore(Space, record["space"])
        occupancy = Occupancy(space, state["occupancy.kept"].shape[-1], device)
        model = VolumetricModel(config, self, occupancy, learned=Learned.like(state, occupancy.kept.device))
        model.load(state)
        return model


class VolumetricModel:
    """A nerf.model.Model: everything a checkpoint holds lives here."""

    def __init__(
        self,
        config: ModelConfig,
        family: VolumetricFamily,
        occupancy: Occupancy,
        seed: int = 0,
        learned: Learned | None = None,
    ) -> None:
        """Make a model that is a thin, even fog, on the occupancy grid's device."""
        self.learned = learned = learned or Learned()
        self.converged, self.alignment, self.appearance = learned.converged, learned.alignment, learned.appearance
        self.config, self.family, self.occupancy = config, family, occupancy
        self.space, self.device = occupancy.space, occupancy.kept.device
        finest = min(round(config.finest * self.space.detail), MOST_CELLS)
        grid = GridConfig(log2_size=config.log2_size, finest=finest, tables=self.space.tables)
        self.field = Field(FieldConfig(grid, MLPConfig(width=config.width)), self.device, seed)
        self.sky = Sky(SkyConfig(), self.device)
        self.sampler = Sampler(self.space, occupancy)
        self.proposals = Proposals(family.proposals, self.sampler, self.device, seed + 1, family.anti_aliased)
        self._renderer = kernels_for(self.device).render
        self._optimiser = Optimiser(self.parameters(), self._copies())

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Do a step of training; see nerf.model.Model."""
        key = config.seed, step
        world = here()
        count = config.rays_at(progress, 1.0 if scene.depth_m is None else self.family.rays_growth)
        drawn = scene.pixels(count * world.size, *key)
        pixels, share = Pixels(*(each[world.part(count)] for each in drawn)), None
        if self.converged is not None:
            pixels, share = self.converged.spin(pixels, self.config.sampler.roulette_rays, key)
        rays = replace(scene.rays(*pixels), share=share).to(self.device)
        which = None if self.appearance is None else numbers(scene, pixels.frame).to(self.device)
        rules = config.losses.of(scene.guessed)
        rules = replace(rules, distortion=rules.distortion * self.family.distortion)
        aligned = rays
        if self.alignment is not None:
            frame = torch.from_numpy(pixels.frame).to(self.device)
            aligned = self.alignment.applied(frame, rays)
        batch = self.backward(aligned, rules, key, progress, which)
        if self.alignment is not None:
            self.alignment.learn(frame, rays, prior_weight(rules, rays), batch.rendered)
        if self.converged is not None:
            self.converged.learn(pixels, batch.each.cpu())
        parameters = self.parameters()
        still = [] if "interlevel" in batch.terms else [name for name in parameters if name.startswith(PROPOSAL)]
        add_up({name: tensor for name, tensor in parameters.items() if name not in still})
        self._optimiser.step(config.optimiser, progress, still)
        if step % OCCUPANCY_EVERY == 0:
            self.occupancy.update(self.field.density, key)
        return StepResult(batch.terms, batch.total, len(rays) * world.size, sum(world.counts(batch.samples)))

    def backward(
        self, rays: Rays, config: LossConfig, key: Key, progress: float, which: Tensor | None = None
    ) -> Losses:
        """Go forward and back with a batch; gradients are left in the parameters' `.grad`.

        which (r,): numbers of the rays' training frames, for their appearance; None: the colours are as they are.
        """
        samples, rounds = self._sample(rays, key, progress)
        units = rays.units
        sigma, rgb = self.field.forward(samples, units, self._footprint(rays, samples))
        sky = self.sky.forward(units)
        rendered = self._renderer.forward(samples, sigma, rgb, sky)
        if self.appearance is None or which is None:
            batch = losses(config, samples, rays, sigma, rendered)
        else:
            batch = losses(config, samples, rays, sigma, self.appearance.seen(rendered, which))
            self.appearance.backward(rendered.rgb, which, batch.gradients)
        d_sigma, d_rgb, d_sky = self._renderer.backward(samples, sigma, rgb, sky, rendered, batch.gradients)
        self._learn(samples, sigma, (d_sigma, d_rgb), key)
        self.sky.backward(d_sky)
        if self.proposals.learn_at(key[1], progress, self.config.sampler.proposals_every):
            wheel = Wheel(self.config.sampler.roulette_proposals, key, roulette.PROPOSED)
            batch.terms["interlevel"] = self.proposals.backward(rounds, samples, rendered, rays.share, wheel)
        self.occupancy.observe(samples, sigma)
        return batch

    def _learn(self, samples: Samples, sigma: Tensor, gradients: tuple[Tensor, Tensor], key: Key) -> None:
        """Take the gradients by density (m,) and colour (m, 3) back through the field, of the samples that count."""
        config, (d_sigma, d_rgb) = self.config.sampler, gradients
        if config.terminate == 0 and config.roulette_samples == 1:
            self.field.backward(d_sigma, d_rgb)
            return
        weight = (d_sigma * sigma).abs() + d_rgb.abs().sum(1)
        chance = roulette.chances(weight, config.roulette_samples, samples.used)
        if config.terminate:
            chance = torch.where(in_front(samples, sigma) < -math.log(config.terminate), chance, 0.0)
        chance[samples.used :] = 0
        kept = roulette.spin(chance, key, roulette.SAMPLES, samples.used)
        share = 1 / chance.clamp(min=1e-6)
        self.field.backward(d_sigma * share, d_rgb * share[:, None], kept)

    @threads.quiet()
    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view, in pieces that fit into memory."""
        rays = view_rays(camera, T_world_cam).to(self.device)
        pieces = self._pieces([_part(rays, first) for first in range(0, len(rays), RENDER_RAYS)])
        if self.appearance is not None:
            pieces = [replace(each, rgb=self.appearance.at(each.rgb, T_world_cam).clamp(0, 1)) for each in pieces]
        height, width = camera.size

        def whole(name: str) -> np.ndarray:
            return torch.cat([getattr(piece, name) for piece in pieces]).cpu().numpy().reshape(height, width, -1)

        opacity = 1 - whole("transmittance")[..., 0]
        return RenderedView(whole("rgb"), whole("depth_m")[..., 0], whole("median_m")[..., 0], opacity)

    def _pieces(self, parts: list[Rays]) -> list[Rendered]:
        """Render parts of a view; on a CPU side by side, so that no core waits while another prepares a part."""
        if self.device.type != "cpu":
            return [self.render_rays(part) for part in parts]
        rendered: dict[int, Rendered] = {}
        threads.run(len(parts), lambda number: rendered.update({number: self.render_rays(parts[number])}))
        return [rendered[number] for number in range(len(parts))]

    def render_rays(self, rays: Rays) -> Rendered:
        """Render rays without learning."""
        if self.family.proposals:
            samples, _ = self._sample(rays, None, 1.0)
        else:
            samples = self.sampler.march(rays, self.config.sampler.render)
        asked = samples, rays.units, self._footprint(rays, samples)
        limit = self.config.sampler.terminate
        sigma, rgb = walk(self.field, *asked, limit) if limit else self.field.forward(*asked)
        return self._renderer.forward(samples, sigma, rgb, self.sky.forward(rays.units))

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        parts: dict[str, Trainable] = {"field": self.field, "sky": self.sky, **self.proposals.named()}
        return joined({name: part.parameters() for name, part in (parts | self.learned.parts).items()})

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name."""
        own, occupancy, optimiser = self.parameters(), self.occupancy.state(), self._optimiser.state()
        return joined({"model": own, "occupancy": occupancy, "optimiser": optimiser}) | self.learned.state()

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state; ValueError where it is of a model of other settings."""
        copy_into(self.parameters(), under("model", state))
        self.occupancy.load(under("occupancy", state))
        self._optimiser.load(under("optimiser", state))
        self.learned.load(state)

    def record(self) -> dict[str, Any]:
        """Return the space, and whether frames' colours are learned: with config and state it makes the model again."""
        return {"space": asdict(self.space)} | ({} if self.appearance is None else {"appearance": True})

    def _copies(self) -> dict[str, Tensor]:
        """Return the rounded copies of parameters that the kernels read, by the parameters' names."""
        return joined({name: part.copies() for name, part in {"field": self.field, **self.proposals.named()}.items()})

    def _sample(self, rays: Rays, key: Key | None, progress: float) -> tuple[Samples, list[Round]]:
        """Sample rays; with the proposal rounds that led there, near to far."""
        config = self.config.sampler
        rays = self._trusted(rays)
        if self.family.proposals:  # half of a guided ray's samples are theirs: guiding costs no colour
            return self.proposals.sample(rays, config, key, progress)
        if config.guide and rays.depth_m is not None:
            return self.sampler.guided(rays, config.at(progress), key), []
        return self.sampler.march(rays, config.free, key), []

    def _trusted(self, rays: Rays) -> Rays:
        """Return the rays without those prior values that are more likely wrong than samplers can stand."""
        if rays.depth_m is None or rays.weight is None:
            return rays
        return replace(rays, depth_m=torch.where(rays.weight >= self.config.sampler.trust, rays.depth_m, 0.0))

    def _footprint(self, rays: Rays, samples: Samples) -> Tensor | None:
        """Return the samples' extents, (m,) in units of u; None where points will do."""
        return self.space.footprint(samples, rays.pixel) if self.family.anti_aliased and rays.pixel else None


def _part(rays: Rays, first: int) -> Rays:
    piece = slice(first, first + RENDER_RAYS)
    return Rays(rays.origins_m[piece], rays.directions[piece], pixel=rays.pixel)
