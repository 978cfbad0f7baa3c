"""Hash fields learn each training frame's colours: the derivatives, what held-out views gain, and earlier runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from test_nerf_fit import config, corridor

from nerf import checkpoint
from nerf.config import FitConfig
from nerf.fit import fit
from nerf.gaussians.appearance import PULL
from nerf.ray_appearance import RayAppearance, numbers, shown
from nerf.scene import Scene
from nerf.types import Gradients, Rendered
from priors.records import restore

CPU = torch.device("cpu")
SCENE = corridor("4")


def rendered(rgb: torch.Tensor) -> Rendered:
    """What rays show of these colours (r, 3)."""
    clear = torch.zeros(len(rgb))
    return Rendered(rgb, clear, clear, clear, clear)


@given(seed=st.integers(0, 1000))
def test_colours_and_changes_go_back_as_autograd_says(seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    model = RayAppearance.of(SCENE, CPU)
    model.change.copy_(0.1 * torch.randn(model.change.shape, generator=random))
    rgb, pull = torch.rand(2, 50, 3, generator=random)
    which = torch.randint(0, 3, (50,), generator=random)  # no ray sees the fourth frame
    seen = rendered(rgb)
    gradients = replace(Gradients.zeros(seen), rgb=pull.clone())
    model.backward(rgb, which, gradients)
    by_rgb, by_change = rgb.double().requires_grad_(), model.change.double().requires_grad_()
    loss = (shown(by_rgb, by_change[which]) * pull).sum() + PULL * (by_change[which] ** 2).sum() / 50
    wanted = torch.autograd.grad(loss, (by_rgb, by_change))
    torch.testing.assert_close(gradients.rgb.double(), wanted[0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(model.change.grad.double(), wanted[1], rtol=1e-4, atol=1e-5)  # type: ignore[union-attr]


def test_rays_know_their_training_frame() -> None:
    assert numbers(SCENE, np.array([SCENE.train[at] for at in (2, 0, 3)])).tolist() == [2, 0, 3]


def exposed(scene: Scene) -> Scene:
    """The corridor as a camera sees it whose exposure drifts."""
    gains = 0.75 + 0.25 * np.sin(np.arange(len(scene.ids)) * 0.35)
    return replace(scene, images=np.rint(np.asarray(scene.images) * gains[:, None, None, None]).astype(np.uint8))


def without(config: FitConfig) -> FitConfig:
    """The settings of a fit that learns no colours of frames."""
    gaussians = replace(config.model.gaussians, appearance=False)
    return replace(config, model=replace(config.model, gaussians=gaussians))


@pytest.mark.slow
def test_held_out_views_gain_where_exposure_drifts(tmp_path: Path) -> None:
    scene, psnr = exposed(corridor("dense")), []
    for number, settings in enumerate((config(150), without(config(150)))):
        fit(scene, settings, tmp_path / str(number))
        model = checkpoint.open_model(tmp_path / str(number))
        views = [model.render(scene.T_world_cam[at], scene.camera).rgb for at in scene.test]
        psnr.append(-10 * np.log10(np.mean((np.stack(views) - np.asarray(scene.images)[scene.test] / 255) ** 2)))
    assert psnr[0] > psnr[1] + 1


def test_a_run_that_was_begun_without_goes_on_without(tmp_path: Path) -> None:
    """Its checkpoint says so, also where a version that did not know of it wrote the config."""
    fit(SCENE, without(config(4)), tmp_path)
    gone_on = fit(SCENE, config(8), tmp_path)
    assert not [name for name in gone_on.state() if "appearance" in name]


def test_views_show_what_was_learned_of_their_frame(tmp_path: Path) -> None:
    fit(SCENE, config(4), tmp_path)
    model, at = checkpoint.open_model(tmp_path), SCENE.train[1]
    plain = model.render(SCENE.T_world_cam[at], SCENE.camera).rgb
    model.parameters()["appearance.change"][1, :, 3] += 0.125
    brighter = model.render(SCENE.T_world_cam[at], SCENE.camera).rgb
    np.testing.assert_allclose(brighter, np.minimum(plain + 0.125, 1), atol=1e-6)


def test_earlier_configs_say_that_nothing_was_learned_of_frames() -> None:
    assert not restore(FitConfig, {"model": {"gaussians": {}}}).model.gaussians.appearance
