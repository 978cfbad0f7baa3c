"""Warp model: a view is drawn from the training frames nearest to it, by their prior's depth. Nothing is trained.

What a field of the same frames and prior has to beat (after Chaurasia et al., "Depth Synthesis and Local Warps for
Plausible Image-based Navigation", TOG 2013, and Hedman et al., "Scalable Inside-Out Image-Based Rendering", TOG 2016).
The settings were chosen on KITTI drive 0009 and on streets.
"""

from typing import Any

from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.model import StepResult
from nerf.scene import Scene
from nerf.types import RenderedView
from nerf.warp.draw import Warp
from priors.errors import DataError
from priors.types import Camera, Matrix


class WarpFamily:
    """A nerf.model.Family."""

    unread = ("model.width", "model.sampler", "model.gaussians", "losses", "rays", "rays_growth")
    trained = False
    """Its models learn nothing: they are as good as their frames and prior at once."""

    def start(self, scene: Scene, config: FitConfig, device: str) -> "WarpModel":
        """Make a model of a scene with a prior; DataError without one."""
        model = WarpModel(config.model)
        model.show(scene)
        return model

    def open(self, config: ModelConfig, record: dict[str, Any], state: dict[str, Tensor], device: str) -> "WarpModel":
        """Make a model again; before it renders, `show` gives it its frames."""
        return WarpModel(config, record["frames"])


class WarpModel:
    """A nerf.model.Model that shows frames of its scene: a nerf.model.ShowsScene."""

    def __init__(self, config: ModelConfig, digest: str | None = None) -> None:
        """Make a model; `digest` tells which frames it was made of."""
        self.config, self._digest = config, digest
        self._warp: Warp | None = None

    def show(self, scene: Scene) -> None:
        """Take the scene's training frames and their prior.

        Raises:
            DataError: there is no prior, or its maps are not those that the model was made of.
        """
        warp = Warp(scene)
        digest = warp.frames.digest()
        if self._digest not in (None, digest):
            raise DataError(f"{scene.name}: the prior's maps have changed since the run was made: nerf fit again")
        self._warp, self._digest = warp, digest

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Refuse: there is nothing to train."""
        raise ValueError("the warp has nothing to train")

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Draw a view; what no frame shows is filled from around, with opacity 0."""
        if self._warp is None:
            raise ValueError("the warp was not given its frames: call show(scene)")
        return self._warp.view(T_world_cam, camera)

    def parameters(self) -> dict[str, Tensor]:
        """Return nothing: there is nothing to train."""
        return {}

    def state(self) -> dict[str, Tensor]:
        """Return nothing: the frames stay where they are."""
        return {}

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over nothing."""

    def record(self) -> dict[str, Any]:
        """Return which frames it shows, as a hash."""
        return {"frames": self._digest}
