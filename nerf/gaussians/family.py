"""Splat family: how a field of Gaussians begins, by a prior or by a hash field, and is opened again."""

from typing import Any

import torch
from torch import Tensor

from nerf import fields
from nerf.config import FitConfig, ModelConfig
from nerf.gaussians.field_first import FieldFirst
from nerf.gaussians.planted import empty, planted
from nerf.kernels import rasteriser_for
from nerf.model import Family, GoesOn, Model
from nerf.quality import BEST
from nerf.scene import Scene


def _field() -> Family:
    """Return the family that shows the surfaces where no prior does."""
    return fields.family(BEST)


def _expect_drawn(config: FitConfig, device: str) -> None:
    """Raise DataError, before anything is made, where the rasteriser that is asked for is not there."""
    rasteriser_for(torch.device(device), config.model.gaussians.rasteriser)


class SplatFamily:
    """A nerf.model.Family."""

    unread = (
        "model.width",
        "model.sampler",
        "losses.distortion",
        "losses.opacity_power",
        "losses.weigh",
        "rays_growth",
    )

    def start(self, scene: Scene, config: FitConfig, device: str) -> Model:
        """Make a model of a scene from its prior; without one, a hash field that finds the surfaces first."""
        _expect_drawn(config, device)
        if scene.depth_m is None:
            return FieldFirst(_field().start(scene, config, device), torch.device(device))
        return planted(scene, config, torch.device(device))

    def go_on(self, scene: Scene, config: FitConfig, record: dict[str, Any], device: str) -> Model:
        """Make a model that is ready to load a checkpoint."""
        _expect_drawn(config, device)
        on, field = torch.device(device), _field()
        if "space" in record and isinstance(field, GoesOn):
            return FieldFirst(field.go_on(scene, config, record, device), on)
        model = empty(config.model, on)
        return FieldFirst(model, on, tuple(record["begun"])) if "begun" in record else model

    def open(self, config: ModelConfig, record: dict[str, Any], state: dict[str, Tensor], device: str) -> Model:
        """Make a model again of what a checkpoint holds: Gaussians, or the hash field before them."""
        if "space" in record:
            return _field().open(config, record, state, device)
        model = empty(config, torch.device(device))
        model.load(state)
        return model
