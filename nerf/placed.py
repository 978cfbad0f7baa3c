"""Placed model: a model whose views are asked for in the drive's own frame, wherever the scene's origin is."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.model import Model, StepResult
from nerf.scene import Scene
from nerf.types import RenderedView
from priors.origin import Offset, without
from priors.types import Camera, Matrix


@dataclass(frozen=True)
class PlacedModel:
    """A nerf.model.Model that takes the origin off poses, in float64, before it renders; the rest is the model's."""

    model: Model
    """Works in the scene's frame."""
    origin_m: Offset
    """Where the scene's frame begins in the drive's, metres."""

    @property
    def config(self) -> ModelConfig:
        """What the model is."""
        return self.model.config

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view from a pose in the drive's frame."""
        return self.model.render(without(self.origin_m, T_world_cam), camera)

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Do a step of training on the scene, whose frame is the model's own."""
        return self.model.train(scene, config, step, progress)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        return self.model.parameters()

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name."""
        return self.model.state()

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state."""
        self.model.load(state)

    def record(self) -> dict[str, Any]:
        """Return what else makes this model again."""
        return self.model.record()
