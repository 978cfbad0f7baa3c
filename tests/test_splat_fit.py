"""Fits of Gaussians: they learn, grow within a budget, and resume bit for bit. On a small analytic corridor."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_nerf_fit import corridor

from nerf import checkpoint, fields
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.gaussians import growth
from nerf.gaussians.config import GaussianConfig
from nerf.gaussians.growth import Growth, grown, halves, matrices
from nerf.gaussians.model import CAP_M, SplatModel
from nerf.gaussians.shot import position_at
from nerf.gaussians.types import Drawing, Gaussians, SplatMoments, Viewpoint
from nerf.kernels.plain import splat as plain
from nerf.losses import LossConfig
from nerf.scene import Scene
from priors.errors import DataError, UsageError
from priors.geometry import crop

pytestmark = pytest.mark.splats


class Killed(Exception):
    """A fit was stopped at a step."""


def kill(at: int) -> Callable[[Status], None]:
    """Stop a fit at a step."""

    def on_step(status: Status) -> None:
        if status.step == at:
            raise Killed

    return on_step


def trained(scene: Scene, steps: int, **changes: Any) -> SplatModel:
    """Train so many steps on frames alone, without what `fit` does around them."""
    settings = config(steps, virtual_views=0.0, **changes)
    model = fields.family("splat").start(scene, settings, "cpu")
    assert isinstance(model, SplatModel)
    for step in range(steps):
        model.train(scene, settings, step, step / steps)
    return model


def config(steps: int, losses: LossConfig | None = None, **settings: Any) -> FitConfig:
    model = ModelConfig("splat", gaussians=GaussianConfig(**{"start_step": 4, **settings}))
    return FitConfig(model, losses or LossConfig(), rays=64, steps=steps, seconds=None)


def psnr(model: SplatModel, scene: Scene, position: int) -> float:
    view = model.render(scene.T_world_cam[position], scene.camera)
    return float(-10 * np.log10(np.mean((view.rgb - scene.images[position] / 255) ** 2)))


@pytest.mark.parametrize("loss", ["none", "l1", "kl", "urf"])
def test_every_loss_learns_colour_and_keeps_depth(loss: Any) -> None:
    scene, settings = corridor("sparse"), config(30, LossConfig(loss))
    model = fields.family("splat").start(scene, settings, "cpu")
    assert isinstance(model, SplatModel)
    before = psnr(model, scene, scene.test[0])
    results = [model.train(scene, settings, step, step / 30) for step in range(30)]
    assert psnr(model, scene, scene.test[0]) > before + 2
    assert ("depth" in results[0].terms) == (loss != "none")
    assert all(torch.isfinite(tensor).all() for tensor in model.state().values())
    view, truth_m = model.render(scene.T_world_cam[9], scene.camera), scene.depth_m[9]  # type: ignore[index]
    seen = (truth_m > 0) & (truth_m < 30)
    assert np.median(np.abs(view.depth_m - truth_m)[seen] / truth_m[seen]) < (0.1 if loss == "none" else 0.06)


def test_the_sky_is_left_open() -> None:
    scene = corridor("sparse")
    sky = (np.asarray(scene.images) == np.rint(255 * np.array([0.6, 0.8, 1.0])).astype(np.uint8)).all(-1)
    scene, settings = replace(scene, sky=sky.astype(np.uint8)), config(20)
    model = fields.family("splat").start(scene, settings, "cpu")
    for step in range(20):
        result = model.train(scene, settings, step, step / 20)
    assert "sky" in result.terms
    opacity = model.render(scene.T_world_cam[9], scene.camera).opacity
    assert opacity[sky[9]].mean() < 0.3 < 0.8 < opacity[~sky[9]].mean()


def test_a_resumed_run_ends_in_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed before, between and after looks that change how many Gaussians there are."""
    monkeypatch.setattr(growth, "EVERY", 5)
    scene, settings = corridor("8"), config(24, degree=1)
    whole = fit(scene, settings, tmp_path / "whole")

    for at in (3, 11, 17):
        with pytest.raises(Killed):
            fit(scene, settings, tmp_path / "parts", kill(at))
    parts = fit(scene, settings, tmp_path / "parts")
    assert len(whole.gaussians) != len(fields.family("splat").start(scene, settings, "cpu").gaussians)  # type: ignore[attr-defined]
    assert whole.state().keys() == parts.state().keys()
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, parts.state()[name]), name
    opened = checkpoint.open_model(tmp_path / "whole").render(scene.T_world_cam[9], scene.camera)
    assert np.array_equal(opened.rgb, whole.render(scene.T_world_cam[9], scene.camera).rgb)


def test_a_checkpoint_of_another_degree_is_told_in_one_line(tmp_path: Path) -> None:
    scene = corridor("4")
    fit(scene, config(2, degree=0), tmp_path)
    with pytest.raises(DataError, match=r"made with other settings.*harmonics"):
        fit(scene, config(4, degree=2), tmp_path)


def test_each_view_is_drawn_once_a_lap() -> None:
    train = [3, 5, 8, 11]
    drawn = [position_at(train, 7, step) for step in range(12)]
    assert [sorted(drawn[lap : lap + 4]) for lap in (0, 4, 8)] == [train] * 3
    assert (
        drawn
        == [position_at(train, 7, step) for step in range(12)]
        != [position_at(train, 8, step) for step in range(12)]
    )


def test_a_part_of_a_view_is_what_the_whole_shows_there() -> None:
    """As a live view draws it, piece by piece; wide Gaussians beside the image are drawn a bit otherwise."""
    scene, settings = corridor("sparse"), config(5)
    model = fields.family("splat").start(scene, settings, "cpu")
    whole = model.render(scene.T_world_cam[9], scene.camera)
    part = model.render(scene.T_world_cam[9], crop(scene.camera, 8, 0, (16, 64)))
    assert np.abs(part.rgb - whole.rgb[8:]).mean() < 0.02
    assert np.median(np.abs(part.depth_m - whole.depth_m[8:]) / whole.depth_m[8:]) < 0.02


def test_a_low_pass_is_that_of_the_drawing() -> None:
    scene, pictures = corridor("sparse"), []
    for low_pass_px2 in (0.0, 0.2):
        settings = config(1, low_pass_px2=low_pass_px2, degree=0, appearance=False)
        model = fields.family("splat").start(scene, settings, "cpu")
        assert isinstance(model, SplatModel)
        drawing = Drawing(degree=0, low_pass_px2=low_pass_px2, cap_m=CAP_M)
        drawn = plain.rasterise(model.gaussians, Viewpoint(scene.camera, scene.T_world_cam[9]), drawing)
        view = model.render(scene.T_world_cam[9], scene.camera)
        torch.testing.assert_close(torch.from_numpy(view.opacity), drawn.opacity, rtol=0, atol=1e-3)
        pictures.append(view.opacity)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.01


def some(count: int, seed: int = 0) -> Gaussians:
    random = torch.Generator().manual_seed(seed)
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, 4, 3))
    return Gaussians(*(torch.randn(shape, generator=random) for shape in shapes))


def test_growth_splits_what_is_pulled_at_and_deletes_what_is_clear() -> None:
    gaussians = some(100)
    gaussians.opacities[:] = 2.0
    gaussians.opacities[:10] = -6.0
    moments = SplatMoments(some(100, 1), some(100, 2), torch.ones(100))
    known = Growth(torch.arange(100.0), torch.full((100,), 2.0))
    made, means = grown(gaussians, moments, known, 93)
    assert len(made) == 93, "90 are left, and the budget has room for three"
    assert torch.equal(made.means_m[:87], gaussians.means_m[10:97]), "those pulled at hardest are the last three"
    assert torch.equal(means.mean.means_m[:87], moments.mean.means_m[10:97])
    assert not means.square.harmonics[87:].any() and len(means.unit_m) == 93
    assert torch.allclose((made.means_m[87:90] + made.means_m[90:]) / 2, gaussians.means_m[97:], atol=1e-5)
    assert len(grown(gaussians, moments, known, 40)[0]) == 90, "a smaller budget deletes nothing that shows"
    assert len(grown(gaussians, moments, Growth.of(100, torch.device("cpu")), 1000)[0]) == 90, "nothing was seen"


def test_halves_lie_along_the_longest_axis() -> None:
    gaussians = some(50)
    one, two = halves(gaussians)
    apart = one.means_m - two.means_m
    longest = gaussians.log_scales.argmax(1)
    axes = matrices(gaussians.rotations)[torch.arange(50), :, longest]
    assert torch.allclose((apart * axes).sum(1).abs(), torch.linalg.vector_norm(apart, dim=1), rtol=1e-4)
    assert (one.log_scales < gaussians.log_scales).all()
    assert torch.equal(one.harmonics, two.harmonics)


@pytest.mark.parametrize("name, value", [("most_gaussians", 0), ("degree", 4), ("dssim", 1.5), ("low_pass_px2", -0.1)])
def test_a_wrong_setting_is_told(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=f"--{name.replace('_', '-')} .*expected"):
        GaussianConfig(**{name: value})  # type: ignore[arg-type]


def test_bad_depth_values_do_no_harm() -> None:
    scene = corridor("sparse")
    assert scene.depth_m is not None
    depth_m = scene.depth_m.copy()
    depth_m[:, ::3], depth_m[:, 1::3, ::2], depth_m[:, 2::3, :4] = np.nan, np.inf, -5
    scene = replace(scene, depth_m=depth_m)
    for loss in ("l1", "kl", "urf"):
        settings = config(5, LossConfig(loss))  # type: ignore[arg-type]
        model = fields.family("splat").start(scene, settings, "cpu")
        for step in range(5):
            model.train(scene, settings, step, step / 5)
        assert all(torch.isfinite(tensor).all() for tensor in model.state().values())
