"""Fit, checkpoint and view elsewhere (tests/reference/elsewhere.py): nothing of the CPU gets among their tensors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nerf import checkpoint
from nerf.config import FitConfig, ModelConfig
from nerf.fit import fit
from nerf.gaussians import growth
from nerf.gaussians import model as gaussians_model
from nerf.gaussians.config import GaussianConfig
from nerf.losses import LossConfig
from nerf.model import HoldsGaussians
from nerf.occupancy import WARM_UP
from nerf.sample import SamplerConfig
from nerf.volumetric import VolumetricModel
from tests.reference.elsewhere import DEVICE, Away, Elsewhere, let_numbers_in
from tests.test_nerf_fit import corridor

SLOW = [pytest.param(family, marks=pytest.mark.slow) for family in ("mip360", "nerfpp")]


@pytest.mark.parametrize("family", ["ngp", *SLOW])
def test_a_fit_stays_on_its_device(family: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_numbers_in(monkeypatch)
    scene = corridor("sparse")
    model = ModelConfig(family=family, log2_size=8, width=16, sampler=SamplerConfig(count=8, free=8, render=16))
    config = FitConfig(model=model, losses=LossConfig(loss="urf", trim=0.1), rays=16, steps=2)
    camera = replace(scene.camera, size=(4, 8))
    with Elsewhere():
        made = fit(scene, config, tmp_path, device=str(DEVICE))
        assert isinstance(made, VolumetricModel)
        made.occupancy.update(made.field.density, (0, WARM_UP), probes=64)
        again = checkpoint.open_model(tmp_path, DEVICE)
        view = again.render(scene.T_world_cam[scene.test[0]], camera)
    small = ("optimiser.steps", "appearance.poses")
    assert [name for name, x in made.state().items() if not isinstance(x, Away) and name not in small] == []
    assert np.isfinite(view.rgb).all()
    assert view.rgb.std() > 0


@pytest.mark.splats
@pytest.mark.parametrize("loss", ["urf", "kl", "none"])
def test_gaussians_stay_on_their_device(loss: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every stage, also growing, views between the frames, the sky behind, and without a prior a field before them."""
    let_numbers_in(monkeypatch)
    monkeypatch.setattr(gaussians_model, "LAPS", 0)  # so that virtual views are learned from at once
    monkeypatch.setattr(growth, "EVERY", 1)
    scene = corridor("sparse", prior=loss != "none")
    every = {"normal_weight": 0.1, "appearance": True}
    settings = GaussianConfig(most_gaussians=60, virtual_views=0.9, **(every if loss == "urf" else {}))
    sampler = SamplerConfig(count=8, free=8, render=16)
    model = ModelConfig(family="splat", log2_size=8, width=16, sampler=sampler, gaussians=settings)
    losses = LossConfig(loss=loss, trim=0.1, opacity=0.01, sky_opacity=0.01)
    config = FitConfig(model=model, losses=losses, rays=16, steps=12)
    with Elsewhere():
        made = fit(scene, config, tmp_path, device=str(DEVICE))
        again = checkpoint.open_model(tmp_path, DEVICE)
        view = again.render(scene.T_world_cam[scene.test[0]], scene.camera)
        assert isinstance(again, HoldsGaussians)
        shell = again.splats()
    small = ("sky.steps", "splat.appearance.steps", "splat.appearance.poses")
    assert [name for name, x in made.state().items() if not isinstance(x, Away) and name not in small] == []
    assert all(isinstance(x, Away) for x in shell.tensors().values())
    assert np.isfinite(view.rgb).all() and view.rgb.std() > 0


def test_devices_that_meet_are_found() -> None:
    with Elsewhere():
        there = torch.ones(3, device=DEVICE)
        assert float((2 * there).sum()) == 6
        with pytest.raises(RuntimeError, match="two devices meet"):
            there + torch.ones(3)
        with pytest.raises((RuntimeError, TypeError)):
            there.numpy()
