"""The GPU's rasteriser against its twin, on a GPU or with TRITON_INTERPRET=1 anywhere.

Run by test_nerf_triton.py, and what is marked by test_splat_triton.py.
"""

import os
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.gaussians import losses as gaussians_losses
from nerf.gaussians import model as gaussians_model
from nerf.gaussians.config import GaussianConfig
from nerf.gaussians.planted import planted
from nerf.gaussians.types import NAMES, Drawing, Gaussians, Rates, SplatGradients, SplatMoments, ViewGradients
from nerf.kernels import plain_kernels, triton_kernels
from nerf.kernels.plain import splat as plain
from nerf.kernels.triton import splat as ours
from nerf.losses import LossConfig
from tests.reference.triton_calls import hasten
from tests.splats import SMOOTH, cloud, doubled, one, viewpoint
from tests.test_nerf_fit import corridor
from tests.test_splat_raster import STRANGE, doubled_gradients, near, same_gradients, same_picture, wanted

INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
DEVICE = torch.device("cpu" if INTERPRETED else "cuda")
if INTERPRETED:
    hasten()
more = pytest.mark.splats
DRAWINGS = [Drawing(), Drawing(compensate=False), Drawing(low_pass_px2=0.0)]


@pytest.fixture(autouse=True)
def large_chunks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the interpreter, to which a chunk costs the same whatever its size, take many Gaussians at a time."""
    if INTERPRETED and "as_launched" not in request.node.name:
        monkeypatch.setattr(ours, "_COUNT", 64)
        monkeypatch.setattr(ours, "_COUNT_BACK", 64)
        monkeypatch.setattr(ours, "_ROWS_BACK", 16)


def moved(value: Any, device: torch.device | str = DEVICE) -> Any:
    """Bring tensors, or dataclasses of tensors, to the device."""
    if isinstance(value, Tensor):
        return value.to(device)
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value) if field.name != "kept"}
        return replace(value, **{name: moved(part, device) for name, part in parts.items()})
    return value


def home(value: Any) -> Any:
    return moved(value, "cpu")


def both(gaussians: Gaussians, drawing: Drawing, size: tuple[int, int] = (23, 38), turned: bool = True) -> Any:
    """Return what the kernels and the twin, in float64, draw."""
    seen_from = viewpoint(*size, turned=turned)
    shown = ours.rasterise(moved(gaussians), seen_from, drawing)
    return shown, plain.rasterise(doubled(gaussians), seen_from, drawing)


LOOSE = 1e-4, 1e-3, 1.0


def compare(
    gaussians: Gaussians, drawing: Drawing, turned: bool = True, within: tuple[float, float, float] = (5e-6, 5e-5, 1e-6)
) -> SplatGradients:
    """Compare pictures and gradients; returns ours.

    within: shares of the largest value, of pictures and of gradients, and what that is at least.
    """
    shown, expected = both(gaussians, drawing, turned=turned)
    same_picture(home(shown), expected, within[0])
    given = wanted((23, 38))
    found = home(ours.backward(shown, moved(given)))
    same_gradients(found, plain.backward(expected, doubled_gradients(given)), *within[1:])
    return found


@more
@pytest.mark.parametrize("size", [(1, 1), (3, 70), (40, 33)], ids=str)
@pytest.mark.parametrize("degree", [0, 3])
def test_pictures_of_any_size_equal_the_twin(size: tuple[int, int], degree: int) -> None:
    shown, expected = both(cloud(100, 16), Drawing(degree=degree, cap_m=6.0), size)
    same_picture(home(shown), expected)


@more
@pytest.mark.parametrize("compensate", [True, False])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_equal_the_twin(compensate: bool, degree: int) -> None:
    drawing = replace(SMOOTH, compensate=compensate, degree=degree, cap_m=6.0)
    found = compare(cloud(60, 16, seed=degree), drawing)
    assert found.of.harmonics.shape[1] == (degree + 1) ** 2


def test_many_in_a_tile_as_launched() -> None:
    """With the GPU's own chunks, of which a tile has many."""
    compare(cloud(14, 16, size_m=0.4), replace(SMOOTH, degree=3, cap_m=6.0))


@more
@pytest.mark.parametrize("name", STRANGE)
@pytest.mark.parametrize("drawing", DRAWINGS, ids=["usual", "opaque", "sharp"])
def test_strange_gaussians_are_finite_and_equal_the_twin(name: str, drawing: Drawing) -> None:
    compare(STRANGE[name], drawing, turned=False, within=LOOSE)


def test_strange_gaussians_in_one_view() -> None:
    every = Gaussians(*(torch.cat(x) for x in zip(*(g.tensors().values() for g in STRANGE.values()), strict=True)))
    compare(every, Drawing(), turned=False, within=LOOSE)


def test_equal_depths_are_drawn_in_order() -> None:
    """Many Gaussians at one place: the first is in front."""
    gaussians = one().rows(torch.zeros(50, dtype=torch.int64))
    gaussians.harmonics.copy_(torch.rand(50, 4, 3, generator=torch.Generator().manual_seed(0)))
    same_picture(home(both(gaussians, SMOOTH, turned=False)[0]), plain.rasterise(gaussians, viewpoint(turned=False),
                                                                                 SMOOTH))  # fmt: skip


def test_contributions_equal_the_twin_and_their_way_back() -> None:
    gaussians = cloud(60, 4, size_m=0.7)
    gaussians.opacities[::3] = 20.0  # held to MOST_ALPHA
    shown, expected = both(gaussians, replace(SMOOTH, enough=0.05))
    pixels = torch.tensor([0, 37, 38, 500, 500, 23 * 38 - 1])
    assert float(home(shown.opacity).flatten()[pixels].max()) > 0.95, "a pixel that is finished"
    made, theirs = ours.contributions(shown, moved(pixels)), plain.contributions(expected, pixels)
    for name in ("pixels", "offsets", "gaussian"):
        torch.testing.assert_close(home(getattr(made, name)), getattr(theirs, name))
    for name in ("alphas", "weights", "depths_m"):
        near(home(getattr(made, name)), getattr(theirs, name), 1e-5, name)
    random = torch.Generator().manual_seed(0)
    d_weights, d_tau = (torch.randn(len(made.weights), generator=random) for _ in range(2))
    nothing = torch.zeros(23, 38, 3)
    for weights, tau in ((d_weights, d_tau), (d_weights, None), (None, d_tau)):
        found = ours.backward(shown, ViewGradients(moved(nothing), None, None, made, moved(weights), moved(tau)))
        double = (None if x is None else x.double() for x in (weights, tau))
        same_gradients(
            home(found), plain.backward(expected, ViewGradients(nothing.double(), None, None, theirs, *double))
        )
    none = ours.contributions(shown, moved(torch.zeros(0, dtype=torch.int64)))
    assert none.offsets.tolist() == [0] and not len(none.gaussian)


@more
def test_a_background_lies_behind_and_the_median_can_be_left_out() -> None:
    background, given, drawing = torch.rand(23, 38, 3), wanted((23, 38)), replace(SMOOTH, median=False)
    gaussians, seen_from = cloud(40), viewpoint()
    shown = ours.rasterise(moved(gaussians), seen_from, drawing, moved(background))
    expected = plain.rasterise(doubled(gaussians), seen_from, drawing, background.double())
    same_picture(home(shown), expected)
    found = ours.backward(shown, moved(given))
    same_gradients(home(found), plain.backward(expected, doubled_gradients(given)))
    assert not shown.median_m.any()


@more
def test_a_pixel_that_is_finished_stays_as_it_is() -> None:
    whole, soon = (both(cloud(100, size_m=0.6), Drawing(enough=x))[0] for x in (0.0, 0.1))
    assert 0 < float((whole.opacity - soon.opacity).max()) < 0.1
    assert float((1 - whole.opacity).min()) < 0.01
    compare(cloud(100, size_m=0.6), replace(SMOOTH, enough=0.05))


@more
def test_a_colour_that_is_no_number_is_seen() -> None:
    """And not drawn as black: a fit must find it."""
    gaussians = one()
    gaussians.harmonics[0, 0, 1] = torch.nan
    shown = home(ours.rasterise(moved(gaussians), viewpoint(turned=False), SMOOTH))
    middle = shown.rgb[shown.opacity == shown.opacity.max()]
    assert bool(torch.isnan(middle[:, 1]).all()) and bool(torch.isfinite(shown.rgb[..., [0, 2]]).all())


def test_other_numbers_than_float32_are_refused() -> None:
    with pytest.raises(ValueError, match="expected float32"):
        ours.rasterise(moved(doubled(one())), viewpoint(), SMOOTH)


def test_adam_equals_the_twin() -> None:
    random, n, rows = torch.Generator().manual_seed(0), 50, torch.tensor([3, 4, 20, 49])
    start, unit_m = cloud(n, 4), torch.rand(n, generator=random)
    given = cloud(4, 4, seed=1)
    given.means_m[0] = torch.tensor([1e30, -1e30, torch.nan])  # held; and a fit must see what is no number
    gradients = SplatGradients(rows, given, torch.zeros(4), torch.zeros(6))
    found = []
    for kernels, device in ((ours, DEVICE), (plain, "cpu")):
        own, some = moved(start.rows(torch.arange(n)), device), moved(gradients, device)
        moments = SplatMoments(own.zeros(), own.zeros(), unit_m.to(device))
        for step in (1, 2):
            kernels.adam(own, some, moments, Rates(0.1, 0.01, 0.02, 0.03, 0.04, 0.05), step)
        found.append([home(getattr(x, name)) for x in (own, moments.mean, moments.square) for name in NAMES])
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=2e-5, atol=1e-6, equal_nan=True)


@pytest.mark.parametrize(
    ("share", "weighted"), [(0.2, True), *(pytest.param(s, False, marks=more) for s in (0.0, 0.2, 1.0))]
)
def test_the_colour_loss_equals_the_twin(share: float, weighted: bool) -> None:
    random = torch.Generator().manual_seed(0)
    rgb, truth, weight = (torch.rand(13, 19, *more, generator=random) for more in ((3,), (3,), ()))
    rgb[5], given = truth[5], weight if weighted else None
    found = ours.colour_loss(moved(rgb), moved(truth), share, moved(given))
    theirs = plain.colour_loss(rgb.double(), truth.double(), share, None if given is None else given.double())
    for name in ("absolute", "dissimilarity", "total"):
        assert getattr(found, name) == pytest.approx(getattr(theirs, name), abs=2e-6)
    near(home(found.d_rgb), theirs.d_rgb, 2e-5)


def test_pictures_smaller_than_a_window() -> None:
    rgb, truth = torch.rand(2, 4, 5, 3)
    near(home(ours.colour_loss(moved(rgb), moved(truth), 0.0).d_rgb), plain.colour_loss(rgb, truth, 0.0).d_rgb, 1e-6)
    with pytest.raises(ValueError, match="11 x 11"):
        ours.colour_loss(moved(rgb), moved(truth), 0.2)


@more
def test_a_fit_goes_the_way_of_the_twins(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole chain of training on the kernels, from the start to the sky behind, and a view at the end."""
    scene = corridor("sparse")
    model = ModelConfig(family="splat", gaussians=GaussianConfig(most_gaussians=60, normal_weight=0.01))
    config = FitConfig(model=model, losses=LossConfig(loss="urf", trim=0.1, opacity=0.01), rays=16, steps=2)
    found = []
    for kernels, device in ((triton_kernels(), DEVICE), (plain_kernels(), torch.device("cpu"))):
        for module in (gaussians_model, gaussians_losses):
            monkeypatch.setattr(module, "kernels_for", lambda device, kernels=kernels: kernels)
        monkeypatch.setattr(gaussians_model, "rasteriser_for", lambda device, chosen, kernels=kernels: kernels.splat)
        made = planted(scene, config, device)
        first = made.train(scene, config, 0, 0.0)
        means = [home(x).clone() for x in made.moments.mean.tensors().values()]  # a tenth of the gradients
        second = made.train(scene, config, 1, 0.5)
        view = made.render(scene.T_world_cam[scene.test[0]], scene.camera)
        found.append((home(first.total), home(second.total), means, view))
    (*totals, means, view), (*expected, theirs, other) = found
    for total, right in zip(totals, expected, strict=True):
        torch.testing.assert_close(total, right, rtol=2e-3, atol=1e-4)
    for name, mine, right in zip(NAMES, means, theirs, strict=True):
        assert right.abs().max() > 0, name
        near(mine, right, 5e-3, name)
    assert float(abs(view.rgb - other.rgb).mean()) < 5e-3 < float(view.rgb.std())
