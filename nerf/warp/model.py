"""Warp model: a view is drawn from the training frames nearest to it, by their prior's depth. Nothing is trained.

What a field of the same frames and prior has to beat (after Chaurasia et al., "Depth Synthesis and Local Warps for
Plausible Image-based Navigation", TOG 2013, and Hedman et al., "Scalable Inside-Out Image-Based Rendering", TOG 2016).
The settings were chosen on KITTI drive 0009 and on streets.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.kernels.cpu.warp_draw import NONE, draw
from nerf.kernels.cpu.warp_fuse import Fused, Rules, Views, fuse
from nerf.model import StepResult
from nerf.scene import Scene
from nerf.types import RenderedView
from nerf.warp.fill import fill
from nerf.warp.frames import Frames
from priors.errors import DataError
from priors.geometry import invert
from priors.machine import threads
from priors.types import Camera, Matrix

NEAREST = 4
"""Frames a view is made of."""
PARALLAX_RAD = 0.06
"""Parallax that makes two views of a place unlike by 1."""
FARTHEST_M = 1e4
"""Depth of what is infinitely far."""


class WarpFamily:
    """A nerf.model.Family."""

    unread = ("model.width", "model.sampler", "model.gaussians", "losses", "rays")
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
    """A nerf.model.Model that shows frames of its scene: a nerf.model.ShowsScene. It works on the CPU."""

    def __init__(self, config: ModelConfig, digest: str | None = None) -> None:
        """Make a model; `digest` tells which frames it was made of."""
        self.config, self._digest = config, digest
        self._frames: Frames | None = None

    def show(self, scene: Scene) -> None:
        """Take the scene's training frames and their prior.

        Raises:
            DataError: there is no prior, or its maps are not those that the model was made of.
        """
        frames = Frames(scene)
        digest = frames.digest()
        if self._digest not in (None, digest):
            raise DataError(f"{scene.name}: the prior's maps have changed since the run was made: nerf fit again")
        self._frames, self._digest = frames, digest

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Refuse: there is nothing to train."""
        raise ValueError("the warp has nothing to train")

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Draw, compare and blend the nearest frames; what none of them shows is filled from around, with opacity 0."""
        if self._frames is None:
            raise ValueError("the warp was not given its frames: call show(scene)")
        positions = self._frames.nearest(T_world_cam, NEAREST)
        seen = self._draw(positions, T_world_cam, camera)
        out = Fused(
            np.zeros((*camera.size, 3), np.float32), np.full(camera.size, NONE), np.zeros(camera.size, np.bool_)
        )
        views, rules = self._views(positions, T_world_cam, camera), rules_for(self._frames.scene.camera)
        threads.over(camera.size[0], lambda first, last: fuse(seen, views, rules, first, last, out))
        rgb = fill(out.rgb, out.shown) / np.float32(255)
        inverse = fill(out.inverse, out.inverse >= 0)
        depth_m = (1 / np.maximum(inverse, np.float32(1 / FARTHEST_M))).astype(np.float32)
        return RenderedView(np.clip(rgb, 0, 1), depth_m, depth_m, out.shown.astype(np.float32))

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

    def _draw(self, positions: list[int], T_world_cam: Matrix, camera: Camera) -> npt.NDArray[np.float32]:
        """Draw each frame's surface into the view: inverse depths (n, height, width)."""
        assert self._frames is not None
        frames, seen = self._frames, np.full((len(positions), *camera.size), NONE)
        surfaces = [frames.surface(position) for position in positions]

        def draw_one(index: int) -> None:
            surface, pose = surfaces[index], frames.scene.T_world_cam[positions[index]]
            M = between(frames.scene.camera, pose, camera, T_world_cam)
            draw(surface.inverse, surface.joins, M, seen[index])

        threads.run(len(positions), draw_one)
        return seen

    def _views(self, positions: list[int], T_world_cam: Matrix, camera: Camera) -> Views:
        """Stack what the frames hold."""
        assert self._frames is not None
        scene, surfaces = self._frames.scene, [self._frames.surface(position) for position in positions]
        there = [between(camera, T_world_cam, scene.camera, scene.T_world_cam[position]) for position in positions]
        images = np.stack([scene.images[position] for position in positions])
        inverse, trust = (np.stack([getattr(each, name) for each in surfaces]) for name in ("inverse", "trust"))
        return Views(images, inverse, trust, np.stack(there))


def between(camera: Camera, T_world_cam: Matrix, other: Camera, T_world_other: Matrix) -> npt.NDArray[np.float64]:
    """Return the matrix (3, 4) from a camera's pixels and inverse depths to another's: see warp_draw.py."""
    T_other_cam = invert(T_world_other) @ T_world_cam
    rotated = other.K @ T_other_cam[:3, :3] @ np.linalg.inv(camera.K)
    return np.hstack([rotated, other.K @ T_other_cam[:3, 3:]])


def rules_for(camera: Camera) -> Rules:
    """Return how frames of a camera are compared and blended."""
    return Rules(
        agree_px=2.0,
        agree_share=0.2,
        parallax_px=PARALLAX_RAD * camera.fx,
        shrinking=2.0,
        softness=0.3,
        own_vote=0.5,
        feather_px=8.0,
    )
