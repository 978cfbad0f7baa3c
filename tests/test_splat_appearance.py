"""What is learned of each frame's colours: its derivatives, what held-out views show, and that it lifts them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from test_nerf_fit import corridor
from test_splat_fit import config, psnr, trained

from nerf import fields
from nerf.gaussians.appearance import Appearance, changed, unchanged
from nerf.harmonics import harmonics
from nerf.scene import Scene

pytestmark = pytest.mark.splats


def along(places_m: list[float]) -> np.ndarray:
    """Poses along z."""
    poses = np.tile(np.eye(4), (len(places_m), 1, 1))
    poses[:, 2, 3] = places_m
    return poses


@given(seed=st.integers(0, 1000))
def test_colours_go_back_as_autograd_says(seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    rgb, pull = (torch.randn(4, 5, 3, generator=random, dtype=torch.float64) for _ in range(2))
    change = 0.1 * torch.randn(3, 4, generator=random, dtype=torch.float64)
    rgb.requires_grad_()
    (wanted,) = torch.autograd.grad((changed(rgb, change) * pull).sum(), rgb)
    assert torch.allclose(unchanged(pull, change), wanted, rtol=1e-9, atol=1e-12)


def test_a_frame_learns_its_own_change() -> None:
    """Adam goes from no change to the one that was applied, where the pull is that of the mean squared error."""
    model = Appearance(along([0.0, 1.0]), torch.device("cpu"))
    random = torch.Generator().manual_seed(0)
    wanted = torch.tensor([[0.2, 0.0, 0.0, 0.02], [0.0, -0.1, 0.0, 0.0], [0.0, 0.05, 0.1, -0.03]])
    for _ in range(600):
        rgb = torch.rand(8, 9, 3, generator=random)
        off = changed(rgb, model.change[1]) - changed(rgb, wanted)
        model.learn(1, rgb, 2 * off, 1.0)
    assert (model.change[1] - wanted).abs().max() < 0.03
    assert not model.change[0].any(), "the other frame saw nothing"


def test_views_between_frames_show_their_mean() -> None:
    model = Appearance(along([0.0, 4.0, 40.0]), torch.device("cpu"))
    model.change += torch.arange(1.0, 4.0)[:, None, None]
    at = [float(model.at(along([place])[0])[0, 0]) for place in (0.0, 1.0, 2.0, 40.0)]
    assert at == pytest.approx([1.0, 1.25, 1.5, 3.0], abs=1e-5)
    alone = Appearance(along([3.0]), torch.device("cpu"))
    alone.change += 0.5
    assert torch.allclose(alone.at(along([9.0])[0]), alone.change[0])


def test_what_other_programs_show_is_the_frames_mean() -> None:
    random = torch.Generator().manual_seed(0)
    model = Appearance(along([0.0, 1.0]), torch.device("cpu"))
    model.change += 0.1 * torch.randn(2, 3, 4, generator=random)
    own, basis = 0.1 * torch.randn(5, 4, 3, generator=random), harmonics(torch.eye(3))[:, :4]
    own[:, 0] += 1.0  # no colour is below 0

    def colours(coefficients: torch.Tensor) -> torch.Tensor:
        return 0.5 + (basis[:, None, :, None] * coefficients).sum(2)

    wanted = changed(colours(own), model.change.mean(0))
    assert torch.allclose(colours(model.usual(own)), wanted, atol=1e-6)


def exposed(scene: Scene) -> Scene:
    """The corridor as a camera sees it whose exposure drifts; what is clipped is kept dark enough."""
    gains = 0.75 + 0.25 * np.sin(np.arange(len(scene.ids)) * 0.35)
    images = np.rint(np.asarray(scene.images) * gains[:, None, None, None]).astype(np.uint8)
    return replace(scene, images=images)


def test_held_out_views_gain_where_exposure_drifts() -> None:
    scene = exposed(corridor("dense"))
    learned, plain = (trained(scene, 120, start_step=3, appearance=learns) for learns in (True, False))
    gain = [psnr(learned, scene, position) - psnr(plain, scene, position) for position in scene.test]
    assert np.mean(gain) > 1


def test_a_checkpoint_without_it_is_of_other_settings() -> None:
    scene = corridor("8")
    plain = fields.family("splat").start(scene, config(1, appearance=False), "cpu")
    learns = fields.family("splat").start(scene, config(1), "cpu")
    with pytest.raises(ValueError, match=r"appearance\.poses"):
        learns.load(plain.state())
