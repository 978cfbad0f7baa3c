"""Field first: without a prior a hash field finds the surfaces, and Gaussians start from what it shows.

Discs at random depths learn each training frame for itself, and nothing of what lies between. A hash field has one
density for all frames. So a share of the budget trains one; then its depth in some training frames is what a prior's
depth is elsewhere: where Gaussians start.
"""

from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.gaussians.planted import planted
from nerf.model import Model, StepResult
from nerf.scene import Scene
from nerf.types import RenderedView
from priors.geometry import resize
from priors.sky import sky_mask
from priors.types import Camera, Matrix

SHARE = 0.7
"""Share of the budget that trains the hash field."""
FRAMES = 24
"""Training frames whose depth it shows, at most; evenly spread."""
PIXELS = 200_000
"""It shows about so many pixels in all: to render a hash field takes long."""
SOLID = 0.5
"""Opacity from which on what it shows is a surface."""
TRUST = 128
"""How much its depth counts, x 255."""


class FieldFirst:
    """A nerf.model.Model: a hash field at first, Gaussians later."""

    def __init__(self, part: Model, device: torch.device, begun: tuple[int, float] | None = None) -> None:
        """Take the part that learns now; `begun`: step and progress at which Gaussians started, if they did."""
        self.part, self.begun = part, begun
        self._device = device

    @property
    def config(self) -> ModelConfig:
        """What is trained."""
        return self.part.config

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Do a step of training; see nerf.model.Model."""
        if self.begun is None and progress < SHARE:
            return self.part.train(scene, config, step, progress / SHARE)
        if self.begun is None:
            self.part = planted(scene, config, self._device, shown_by(self.part, scene))
            self.begun = step, progress
        first, spent = self.begun
        rest = max(0.0, (progress - spent) / (1 - spent))  # a larger budget takes progress back
        return self.part.train(scene, config, step - first, rest)

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view."""
        return self.part.render(T_world_cam, camera)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        return self.part.parameters()

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name."""
        return self.part.state()

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state; ValueError where it is another model's."""
        self.part.load(state)

    def record(self) -> dict[str, Any]:
        """Return the hash field's space, or when Gaussians started."""
        return self.part.record() if self.begun is None else {"begun": list(self.begun)}


def shown_by(field: Model, scene: Scene) -> Scene:
    """Return some of a scene's training frames as a scene of their own, with the depth that a field shows there."""
    count = min(len(scene.train), FRAMES)
    some = [scene.train[at] for at in np.linspace(0, len(scene.train) - 1, count).round().astype(int)]
    step = max(1, int(np.ceil(np.sqrt(count * scene.camera.size[0] * scene.camera.size[1] / PIXELS))))
    small = resize(scene.camera, (-(-scene.camera.size[0] // step), -(-scene.camera.size[1] // step)))
    images = np.stack([np.asarray(scene.images[position]) for position in some])
    sky = np.stack([sky_mask(image) for image in images])
    depth_m = np.stack([_depth_m(field.render(scene.T_world_cam[at], small), scene.camera.size) for at in some])
    depth_m[sky] = 0
    return Scene(
        scene.name,
        [scene.ids[position] for position in some],
        scene.camera,
        scene.T_world_cam[some],
        images,
        depth_m,
        np.where(depth_m > 0, TRUST, 0).astype(np.uint8),
        list(range(count)),
        [],
        scene.origin_m,
        sky.astype(np.uint8),
    )


def _depth_m(view: RenderedView, size: tuple[int, int]) -> np.ndarray:
    """Return a view's depth (h, w), metres, 0 where it shows no surface, in a larger size."""
    solid = (view.opacity >= SOLID) & (view.median_m > 0)
    inverse = np.where(solid, 1 / np.maximum(view.median_m, 1e-3), 0).astype(np.float32)
    whole = cv2.resize(inverse, size[::-1], interpolation=cv2.INTER_LINEAR)
    known = cv2.resize(solid.astype(np.float32), size[::-1], interpolation=cv2.INTER_LINEAR) > 0.99
    return np.where(known & (whole > 0), 1 / np.maximum(whole, 1e-6), 0).astype(np.float32)
