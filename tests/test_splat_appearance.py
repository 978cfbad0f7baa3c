"""What is learned of each frame's colours: its derivatives, what held-out views show, and that it lifts them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_nerf_fit import corridor
from test_splat_fit import config, psnr, trained
from torch import Tensor

from nerf import fields
from nerf.gaussians.appearance import Appearance
from nerf.gaussians.types import Behind, Rasterised
from nerf.harmonics import harmonics
from nerf.kernels import kernels_for
from nerf.scene import Scene
from nerf.twin import shown as twin
from nerf.twin.shown import changed
from priors.machine import threads

pytestmark = pytest.mark.splats


def along(places_m: list[float]) -> np.ndarray:
    """Poses along z."""
    poses = np.tile(np.eye(4), (len(places_m), 1, 1))
    poses[:, 2, 3] = places_m
    return poses


def picture(seed: int, changes: bool, dtype: torch.dtype) -> tuple[Rasterised, Behind, Tensor]:
    """What was rasterised, what lies behind it, and a pull at each colour; some pixels let no light pass."""
    random, (height, width) = torch.Generator().manual_seed(seed), (19, 7)
    rgb, pull = (torch.randn(height, width, 3, generator=random, dtype=dtype) for _ in range(2))
    opacity = torch.rand(height, width, generator=random, dtype=dtype).mul(1.5).clamp(max=1)
    units = torch.nn.functional.normalize(torch.randn(height * width, 3, generator=random, dtype=dtype), dim=1)
    turn = torch.from_numpy(Rotation.random(random_state=seed).as_matrix()).to(dtype)
    texels = torch.randn(4 + 25, 3, generator=random, dtype=dtype)
    change = 0.3 * torch.randn(3, 4, generator=random, dtype=dtype) if changes else None
    nothing = torch.zeros(0)
    seen = Rasterised(rgb, nothing, opacity, nothing, nothing, nothing, None)
    return seen, Behind(texels, (2, 5), units, turn, change, 0.05), pull


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), changes=st.booleans())
def test_what_a_frame_shows_goes_back_as_autograd_says(seed: int, changes: bool) -> None:
    seen, behind, pull = picture(seed, changes, torch.float64)
    leaves = [seen.rgb, seen.opacity, behind.texels] + ([behind.change] if behind.change is not None else [])
    shown = twin.show(seen, behind)
    found = [x for x in twin.unshow(seen, shown, pull) if x is not None]
    for leaf in leaves:
        leaf.requires_grad_()
    wanted = torch.autograd.grad((twin.show(seen, behind).rgb * pull).sum(), leaves)
    assert len(found) == len(wanted)
    for own, truth in zip(found, wanted, strict=True):
        assert torch.allclose(own, truth, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("changes", [True, False])
def test_compiled_pictures_equal_the_twins_on_any_number_of_threads(changes: bool) -> None:
    kernels = kernels_for(torch.device("cpu")).splat
    seen, behind, pull = picture(3, changes, torch.float32)
    wanted = twin.show(seen, behind)
    gradients = twin.unshow(seen, wanted, pull)
    runs = []
    for count in (1, 3):
        with threads.limited(count):
            shown = kernels.show(seen, behind)
            runs.append((shown.rgb, *kernels.unshow(seen, shown, pull)))
    for own, other, truth in zip(*runs, (wanted.rgb, *gradients), strict=True):
        if truth is None:
            assert own is other is None
        else:
            assert torch.equal(own, other)
            assert torch.allclose(own, truth, rtol=1e-4, atol=1e-5)


def test_a_frame_learns_its_own_change() -> None:
    """Adam goes from no change to the one that was applied, where the pull is that of the mean squared error."""
    model = Appearance(along([0.0, 1.0]), torch.device("cpu"))
    random = torch.Generator().manual_seed(0)
    wanted = torch.tensor([[0.2, 0.0, 0.0, 0.02], [0.0, -0.1, 0.0, 0.0], [0.0, 0.05, 0.1, -0.03]])
    for _ in range(600):
        rgb = torch.rand(8, 9, 3, generator=random)
        pull = 2 * (changed(rgb, model.change[1]) - changed(rgb, wanted)).reshape(-1, 3)
        model.learn(1, torch.cat([pull.T @ rgb.reshape(-1, 3), pull.sum(0)[:, None]], dim=1), 1.0)
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
