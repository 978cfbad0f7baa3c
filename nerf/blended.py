"""Blended model: the fields of a drive's blocks, rendered as one; only those near a view are held in memory."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

from nerf.blocks import Blocks
from nerf.config import FitConfig, ModelConfig
from nerf.model import Model, StepResult
from nerf.scene import Scene
from nerf.types import RenderedView
from priors.types import Camera, Matrix

HELD = 3
"""Fields that are held at once."""
LEAST = 1e-3
"""A block that counts less is not rendered."""


class BlendedModel:
    """A nerf.model.Model that shows what was fitted block by block; it is not trained itself."""

    def __init__(self, blocks: Blocks, open_block: Callable[[int], Model]) -> None:
        """Take where the path is cut, and what opens a block's field."""
        self.blocks, self._open_block = blocks, open_block
        self._held: OrderedDict[int, Model] = OrderedDict()

    @property
    def config(self) -> ModelConfig:
        """What each block is."""
        return self._model(0).config

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view of each block near it, and blend them."""
        weights = self.blocks.weights(T_world_cam)
        near = np.flatnonzero(weights >= LEAST)
        views = [self._model(int(number)).render(T_world_cam, camera) for number in near]
        return blend(views, weights[near] / weights[near].sum())

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Refuse: nerf.fit trains the blocks."""
        raise NotImplementedError("the blocks are trained, one by one")

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors of all blocks by name."""
        return self._all("parameters")

    def state(self) -> dict[str, Tensor]:
        """Return every tensor of all blocks by name."""
        return self._all("state")

    def load(self, state: dict[str, Tensor]) -> None:
        """Refuse: blocks have checkpoints of their own."""
        raise NotImplementedError("the blocks are loaded, one by one")

    def record(self) -> dict[str, Any]:
        """Return nothing: blocks.json has it."""
        return {}

    def _model(self, number: int) -> Model:
        if number not in self._held:
            self._held[number] = self._open_block(number)
            if len(self._held) > HELD:
                self._held.popitem(last=False)
        self._held.move_to_end(number)
        return self._held[number]

    def _all(self, what: str) -> dict[str, Tensor]:
        named: dict[str, Tensor] = {}
        for number in range(len(self.blocks)):
            model = self._model(number)
            own = model.parameters() if what == "parameters" else model.state()
            named |= {f"block{number}.{name}": tensor for name, tensor in own.items()}
        return named


def blend(views: list[RenderedView], weights: np.ndarray) -> RenderedView:
    """Blend views of one place: colours and opacity by the weights (views,), depths by weight times opacity."""
    if len(views) == 1:
        return views[0]
    rgb = sum((w * view.rgb for w, view in zip(weights, views, strict=True)), np.zeros_like(views[0].rgb))
    opacity = sum((w * view.opacity for w, view in zip(weights, views, strict=True)), np.zeros_like(views[0].opacity))
    depth_m = _mean([view.depth_m for view in views], [w * v.opacity for w, v in zip(weights, views, strict=True)])
    solid = [w * (view.median_m > 0) for w, view in zip(weights, views, strict=True)]
    median_m = _mean([view.median_m for view in views], solid)
    made = (part.astype(np.float32) for part in (rgb, depth_m, median_m, opacity))
    return RenderedView(*made)


def _mean(maps: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    """Return the weighted mean of maps, 0 where nothing weighs."""
    total = np.sum(weights, axis=0)
    summed = np.sum([map_ * weight for map_, weight in zip(maps, weights, strict=True)], axis=0)
    return np.asarray(np.where(total > 0, summed / np.maximum(total, 1e-12), 0))
