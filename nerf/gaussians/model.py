"""Splat model: a scene of Gaussians before a sky, started from the prior and trained on whole views."""

import math
from dataclasses import replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.gaussians import growth, normals
from nerf.gaussians.appearance import Appearance
from nerf.gaussians.backdrop import TRAINED, Backdrop
from nerf.gaussians.config import GaussianConfig
from nerf.gaussians.growth import Growth
from nerf.gaussians.losses import ViewLosses, geometry_losses
from nerf.gaussians.normals import Consistency
from nerf.gaussians.rates import rates_at
from nerf.gaussians.shell import shell_of
from nerf.gaussians.shot import Shot, Shots, position_at
from nerf.gaussians.types import Drawing, Gaussians, Rasterised, SplatMoments, Viewpoint
from nerf.gaussians.virtual import VirtualViews, is_virtual
from nerf.kernels import Rasteriser, kernels_for, rasteriser_for
from nerf.losses import LossConfig
from nerf.model import StepResult
from nerf.optimise import Optimiser
from nerf.scene import Scene
from nerf.state import copy_into, joined, under
from nerf.types import OPACITY_FLOOR, RenderedView
from priors.machine import threads
from priors.types import Camera, Matrix

CAP_M = 200.0
"""Depth counts as at most so much in the mean of a pixel."""
LEAST_SIDE_PX = 11
"""Window of SSIM: smaller images are trained by L1 alone."""
LAPS = 8
"""Each training frame is learned from so many times before virtual views are: what they gain comes later."""


class SplatModel:
    """A nerf.model.Model: everything a checkpoint holds lives here."""

    def __init__(self, config: ModelConfig, gaussians: Gaussians, unit_m: Tensor) -> None:
        """Take Gaussians, and the width of the image's cells at each (n,), metres."""
        self.config, self.gaussians = config, gaussians
        self.device = unit_m.device
        self.moments = SplatMoments(gaussians.zeros(), gaussians.zeros(), unit_m)
        self.growth = Growth.of(len(gaussians), self.device)
        self.backdrop = Backdrop(self.device)
        self._sky = Optimiser({f"sky.{name}": x for name, x in self.backdrop.sky.parameters().items()})
        self._splat = kernels_for(self.device).splat
        self._virtual: VirtualViews | None = None
        self._shots = Shots()
        self.appearance: Appearance | None = None
        """What is learned of each training frame's colours; None: nothing."""

    @property
    def settings(self) -> GaussianConfig:
        """What only Gaussians are trained by."""
        return self.config.gaussians

    @cached_property
    def _rasteriser(self) -> Rasteriser:
        """What draws the views that are learned from; whoever only looks at a field needs no package."""
        return rasteriser_for(self.device, self.settings.rasteriser)

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Do a step of training on one whole view; see nerf.model.Model."""
        virtual = self._virtual_share(scene, step, progress)
        shot = self._shot(scene, config, step, virtual)
        seen = self._rasteriser.rasterise(self.gaussians, shot.viewpoint, self._drawing(progress))
        result = self._learn(shot, seen, config, (step, progress))
        lap = math.ceil(len(scene.train) / (1 - virtual))
        if self.settings.densify and growth.is_due(step, lap, progress):
            made = growth.grown(self.gaussians, self.moments, self.growth, self.settings.most_gaussians)
            self.gaussians, self.moments = made
            self.growth = Growth.of(len(self.gaussians), self.device)
        return result

    def _shot(self, scene: Scene, config: FitConfig, step: int, share: float) -> Shot:
        """Return what a step learns from: a training frame or, in a share of the steps, a view between two."""
        later = step - LAPS * len(scene.train)
        between = int(later * share)
        if self._virtual is not None and is_virtual(later, share):
            return self._virtual.shot(config.seed, between)
        position = position_at(scene.train, config.seed, step - between)
        shot = self._shots(scene, position, config.losses, self.device)
        return replace(shot, share=1 - share)

    def _virtual_share(self, scene: Scene, step: int, progress: float) -> float:
        """Return which share of the steps learns from virtual views now; without a prior none does."""
        wanted = self.settings.virtual_views
        if (
            not wanted
            or step < LAPS * len(scene.train)
            or progress >= self.settings.virtual_until
            or scene.depth_m is None
            or len(scene.train) < 2
        ):
            return 0.0
        self._virtual = self._virtual or VirtualViews(scene, self.device)
        return wanted * self._virtual.share

    def _learn(self, shot: Shot, seen: Rasterised, config: FitConfig, at: tuple[int, float]) -> StepResult:
        """Go back from what is seen of a frame, and move the parameters."""
        step, progress = at
        change = self._change(shot.viewpoint.T_world_cam)
        shown = self._splat.show(seen, self.backdrop.behind(shot.viewpoint, change, TRAINED))
        share = self.settings.dssim if min(shot.rgb.shape[:2]) >= LEAST_SIDE_PX else 0.0
        colour = self._splat.colour_loss(shown.rgb, shot.rgb, share, shot.counts)
        rules = _for_fewer(config.losses, shot.share)
        losses = geometry_losses(rules, shot, seen, config.rays, (config.seed, step))
        by = self._splat.unshow(seen, shown, colour.d_rgb)
        losses.d_opacity += by.opacity
        normal = self._normals(shot, seen, losses, step)
        gradients = self._rasteriser.backward(seen, losses.gradients(by.rgb))
        if normal is not None:
            normal.add_to(gradients)
        if self.appearance is not None and shot.frame is not None and by.change is not None:
            self.appearance.learn(shot.frame, by.change, config.optimiser.share(step + 1, progress))
        self.growth.observe(gradients)
        rates = rates_at(config.optimiser, step + 1, progress)
        self._splat.adam(self.gaussians, gradients, self.moments, rates, step + 1)
        self.backdrop.learn(by.texels)
        self._sky.step(config.optimiser, progress)
        terms = {"rgb": torch.nn.functional.mse_loss(shown.rgb, shot.rgb), **losses.terms}
        total = losses.total + colour.total
        return StepResult(terms, total, shot.rgb.shape[0] * shot.rgb.shape[1], len(seen.index))

    def _normals(self, shot: Shot, seen: Rasterised, losses: ViewLosses, step: int) -> Consistency | None:
        """Add the loss of normals where one is asked for and the step's turn has come."""
        weight = normals.EVERY * self.settings.normal_weight
        if weight == 0 or (step + 1) % normals.EVERY:
            return None
        found = normals.consistency(self._splat, self.gaussians, seen, shot.viewpoint, self._drawing(), weight)
        losses.add("normal", found.value, weight)
        losses.pull_depth(seen, found.d_depth)
        return found

    def _drawing(self, progress: float = 1.0) -> Drawing:
        """Return how a training view is drawn: the colours' degree rises."""
        degree = min(self.settings.degree, int(progress * 4 * self.settings.degree))
        return Drawing(degree=degree, low_pass_px2=self.settings.low_pass_px2, cap_m=CAP_M, median=False)

    @threads.quiet()
    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view."""
        viewpoint = Viewpoint(camera, T_world_cam)
        drawing = replace(self._drawing(), median=True, degree=self.settings.degree)
        seen = self._splat.rasterise(self.gaussians, viewpoint, drawing)
        rgb = self._splat.show(seen, self.backdrop.behind(viewpoint, self._change(T_world_cam))).rgb.clamp(0, 1)
        parts = (rgb, seen.depth_m(OPACITY_FLOOR), seen.median_m, seen.opacity)
        return RenderedView(*(part.cpu().numpy() for part in parts))

    def _change(self, T_world_cam: Matrix) -> Tensor | None:
        """Return how the colours of a view are changed (3, 4); None: not at all."""
        return None if self.appearance is None else self.appearance.at(T_world_cam)

    def splats(self) -> Gaussians:
        """Return all that it shows as Gaussians: the sky is a shell far around the others."""
        told = self._sky.state()["sky.texels.square"]
        middle_m = self.gaussians.means_m.mean(0) if len(self.gaussians) else torch.zeros(3, device=self.device)
        shell = shell_of(self.backdrop.sky, told, middle_m, self.gaussians.harmonics.shape[1])
        both = [part.tensors() for part in (self.gaussians, shell)]
        joint = {name: torch.cat([part[name] for part in both]) for name in both[0]}
        if self.appearance is not None:
            joint["harmonics"] = self.appearance.usual(joint["harmonics"])
        return Gaussians(**joint)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        return joined({"gaussians": self.gaussians.tensors(), "sky": self.backdrop.sky.parameters()})

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name."""
        means = {"mean": self.moments.mean.tensors(), "square": self.moments.square.tensors()}
        own = joined({**means, "growth": self.growth.state()}) | {"unit_m": self.moments.unit_m}
        if self.appearance is not None:
            own |= joined({"appearance": self.appearance.state()})
        return joined({"model": self.parameters(), "splat": own, "sky": self._sky.state()})

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state, with its own number of Gaussians; ValueError where it is of other settings."""
        model, own = under("model", state), under("splat", state)
        count = len(model.get("gaussians.means_m", ()))
        gaussians = self._taken(under("gaussians", model), self.gaussians, count)
        mean, square = (self._taken(under(name, own), self.gaussians, count) for name in ("mean", "square"))
        rest = {"unit_m": self.moments.unit_m, **{f"growth.{name}": x for name, x in self.growth.state().items()}}
        found = {name: _sized(name, own, like, count) for name, like in rest.items()}
        copy_into(self.backdrop.sky.parameters(), under("sky", model))
        self._sky.load(under("sky", state))
        if self.settings.appearance:
            self.appearance = Appearance.loaded(under("appearance", own), self.device)
        self.gaussians = gaussians
        self.moments = SplatMoments(mean, square, found["unit_m"])
        self.growth = Growth(found["growth.pull"], found["growth.views"])

    def record(self) -> dict[str, Any]:
        """Return nothing more: config and state make the model again."""
        return {}

    def _taken(self, saved: dict[str, Tensor], like: Gaussians, count: int) -> Gaussians:
        return Gaussians(*(_sized(name, saved, x, count) for name, x in like.tensors().items()))


def _for_fewer(rules: LossConfig, share: float) -> LossConfig:
    """Return losses whose pull by prior and sky is the same over all steps, where only a share of them knows either."""
    weights = {name: getattr(rules, name) / share for name in ("depth_weight", "opacity", "sky_opacity")}
    return replace(rules, **weights)


def _sized(name: str, saved: dict[str, Tensor], like: Tensor, count: int) -> Tensor:
    """Return a saved tensor of `count` rows that are shaped as another's; ValueError where it is another model's."""
    shape = (count, *like.shape[1:])
    if name not in saved or saved[name].shape != shape or not count:
        found = tuple(saved[name].shape) if name in saved else "none"
        raise ValueError(f"expected {name} of shape {shape}, found {found}")
    return saved[name].to(like).clone()
