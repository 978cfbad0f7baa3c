"""Planted: the seeds of a scene as Gaussians, ready to be trained."""

import numpy as np
import torch
from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.gaussians.appearance import Appearance
from nerf.gaussians.model import SplatModel
from nerf.gaussians.seeds import Seeds
from nerf.gaussians.start import start_of
from nerf.gaussians.types import Gaussians
from nerf.harmonics import Y0
from nerf.scene import Scene
from priors.machine import threads

OPACITY = 0.8
"""Of the discs at the start."""


def planted(scene: Scene, config: FitConfig, device: torch.device, shown: Scene | None = None) -> SplatModel:
    """Make a model of a scene; `shown`: some of its frames with depth, where it has no prior."""
    settings = config.model.gaussians
    with threads.quiet():
        seeds = start_of(shown or scene, settings.start_step, settings.most_gaussians)
        model = SplatModel(config.model, *_gaussians(seeds, settings.degree, device))
        model.backdrop.paint(scene)
    if settings.appearance:
        model.appearance = Appearance(scene.T_world_cam[scene.train], device)
    return model


def empty(config: ModelConfig, device: torch.device) -> SplatModel:
    """Make a model without Gaussians: it is ready to load some."""
    return SplatModel(config, *_gaussians(Seeds.joined([]), config.gaussians.degree, device))


def _gaussians(seeds: Seeds, degree: int, device: torch.device) -> tuple[Gaussians, Tensor]:
    """Return seeds as Gaussians, and the width of their cells (n,), metres."""
    harmonics = np.zeros((len(seeds), (degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (seeds.rgb - 0.5) / Y0
    opacities = np.full(len(seeds), np.log(OPACITY / (1 - OPACITY)), np.float32)
    parts = (seeds.means_m, seeds.log_scales, seeds.rotations, opacities, harmonics)
    on = [torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in (*parts, seeds.cell_m)]
    return Gaussians(*on[:-1]), on[-1]
