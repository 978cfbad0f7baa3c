"""The compiled rasteriser against its plain twin, values and gradients; the twin's gradients against differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from nerf.gaussians.types import NAMES, Drawing, Gaussians, Rasterised, SplatGradients, ViewGradients, Viewpoint
from nerf.kernels.cpu import splat as cpu
from nerf.kernels.plain import splat as plain
from nerf.twin import splat as twin
from priors.errors import DataError
from priors.machine import threads
from tests.splats import SMOOTH, cloud, doubled, one, sizes, viewpoint

pytestmark = pytest.mark.splats
IMAGES = ("rgb", "depth_sum", "opacity", "median_m")


def wanted(size: tuple[int, int], seed: int = 1) -> ViewGradients:
    random = torch.Generator().manual_seed(seed)
    return ViewGradients(*(torch.randn(*size, *more, generator=random) for more in ((3,), (), ())))


def doubled_gradients(gradients: ViewGradients) -> ViewGradients:
    values = (getattr(gradients, name) for name in ("rgb", "depth_sum", "opacity"))
    return ViewGradients(*(None if x is None else x.double() for x in values))


def near(ours: Tensor, theirs: Tensor, share: float, what: str = "", least: float = 1e-6) -> None:
    """Compare with a tolerance that is a share of the largest value, or of `least`."""
    assert ours.shape == theirs.shape and bool(torch.isfinite(ours).all()), what
    if theirs.numel():
        atol = share * max(float(theirs.abs().max()), least)
        torch.testing.assert_close(ours, theirs.float(), rtol=0, atol=atol, msg=lambda text: f"{what}: {text}")


def same_picture(ours: Rasterised, theirs: Rasterised, share: float = 5e-6) -> None:
    torch.testing.assert_close(ours.index, theirs.index)
    torch.testing.assert_close(ours.radii_px, theirs.radii_px.float())
    for name in IMAGES:
        near(getattr(ours, name), getattr(theirs, name), share, name)


def same_gradients(ours: SplatGradients, theirs: SplatGradients, share: float = 5e-5, least: float = 1e-6) -> None:
    torch.testing.assert_close(ours.index, theirs.index)
    for name in NAMES:
        near(getattr(ours.of, name), getattr(theirs.of, name), share, name, least)
    near(ours.screen, theirs.screen, share, "screen")
    near(ours.twist, theirs.twist, share, "twist")


@pytest.mark.parametrize("size", [(23, 38), (64, 96), (1, 1), (3, 70)], ids=str)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_pictures_equal_the_twin(size: tuple[int, int], degree: int) -> None:
    gaussians, seen_from = cloud(300, (degree + 1) ** 2), viewpoint(*size)
    drawing = Drawing(degree=degree, cap_m=6.0)
    same_picture(cpu.rasterise(gaussians, seen_from, drawing), plain.rasterise(doubled(gaussians), seen_from, drawing))


@pytest.mark.parametrize("compensate", [True, False])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_equal_the_twin(compensate: bool, degree: int) -> None:
    gaussians, seen_from = cloud(200, 16, seed=degree), viewpoint()
    drawing = replace(SMOOTH, compensate=compensate, degree=degree, cap_m=6.0)
    given = wanted(seen_from.camera.size)
    ours = cpu.backward(cpu.rasterise(gaussians, seen_from, drawing), given)
    theirs = plain.rasterise(doubled(gaussians), seen_from, drawing)
    same_gradients(ours, plain.backward(theirs, doubled_gradients(given)))
    assert ours.of.harmonics.shape[1] == (degree + 1) ** 2


@pytest.mark.parametrize("background", [torch.rand(3), torch.rand(23, 38, 3)], ids=["a colour", "a picture"])
def test_a_background_lies_behind(background: Tensor) -> None:
    gaussians, seen_from, given = cloud(60), viewpoint(), wanted((23, 38))
    ours = cpu.rasterise(gaussians, seen_from, SMOOTH, background)
    theirs = plain.rasterise(doubled(gaussians), seen_from, SMOOTH, background.double())
    same_picture(ours, theirs)
    same_gradients(cpu.backward(ours, given), plain.backward(theirs, doubled_gradients(given)))
    black = cpu.rasterise(gaussians, seen_from, SMOOTH)
    torch.testing.assert_close(ours.rgb, black.rgb + (1 - black.opacity)[..., None] * background)


@pytest.mark.parametrize("compensate", [True, False])
def test_the_twin_has_the_gradients_of_differences(compensate: bool) -> None:
    """In float64, every parameter and the camera's motion."""
    gaussians, seen_from = doubled(cloud(12, 16, seed=3, size_m=0.5)), viewpoint(9, 13)
    drawing = replace(SMOOTH, compensate=compensate, cap_m=6.0)
    given = doubled_gradients(wanted((9, 13)))
    pixels = torch.tensor([0, 40, 41, 99])
    made = plain.contributions(plain.rasterise(gaussians, seen_from, drawing), pixels)
    by_weight, by_tau = (torch.randn(len(made.weights), dtype=torch.float64) for _ in range(2))
    given = replace(given, contributions=made, weights=by_weight, tau=by_tau)

    def loss(some: Gaussians, place: Viewpoint) -> float:
        shown = plain.rasterise(some, place, drawing)
        parts = plain.contributions(shown, pixels)
        values = [(getattr(shown, name) * getattr(given, name)).sum() for name in ("rgb", "depth_sum", "opacity")]
        values += [(parts.weights * by_weight).sum(), (-torch.log1p(-parts.alphas) * by_tau).sum()]
        return float(torch.stack(values).sum())

    found = plain.backward(plain.rasterise(gaussians, seen_from, drawing), given)
    step = 1e-6
    for name in NAMES:
        whole = torch.zeros_like(getattr(gaussians, name))
        whole[found.index] = getattr(found.of, name)
        differences = torch.zeros_like(whole).flatten()
        for i in range(whole.numel()):
            values = []
            for sign in (1, -1):
                changed = getattr(gaussians, name).clone()
                changed.view(-1)[i] += sign * step
                values.append(loss(replace(gaussians, **{name: changed}), seen_from))
            differences[i] = (values[0] - values[1]) / (2 * step)
        torch.testing.assert_close(whole.flatten(), differences, rtol=2e-5, atol=2e-5)
    for axis in range(6):
        values = [loss(gaussians, seen_from._replace(T_world_cam=nudged(seen_from, axis, s * step))) for s in (1, -1)]
        assert math.isclose(float(found.twist[axis]), (values[0] - values[1]) / (2 * step), rel_tol=2e-5, abs_tol=2e-5)


def nudged(seen_from: Viewpoint, axis: int, by: float) -> np.ndarray:
    """Return T_world_cam exp(-twist), the twist along one axis."""
    twist = np.zeros(6)
    twist[axis] = -by
    matrix = np.eye(4)
    matrix[:3, 3] = twist[:3]
    x, y, z = twist[3:]
    matrix[:3, :3] += np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return seen_from.T_world_cam @ matrix


def test_contributions_equal_the_twin_and_add_up() -> None:
    gaussians, seen_from, drawing = cloud(200, 4), viewpoint(), replace(SMOOTH, enough=1e-3)
    pixels = torch.tensor([0, 37, 38, 500, 500, 23 * 38 - 1])
    ours, theirs = cpu.rasterise(gaussians, seen_from, drawing), plain.rasterise(doubled(gaussians), seen_from, drawing)
    made, expected = cpu.contributions(ours, pixels), plain.contributions(theirs, pixels)
    for name in ("pixels", "offsets", "gaussian"):
        torch.testing.assert_close(getattr(made, name), getattr(expected, name))
    for name in ("alphas", "weights", "depths_m"):
        near(getattr(made, name), getattr(expected, name), 1e-5, name)
    pixel = torch.repeat_interleave(torch.arange(len(pixels)), made.offsets.diff())
    stopped = torch.zeros(len(pixels)).index_add(0, pixel, made.weights)
    torch.testing.assert_close(stopped, ours.opacity.flatten()[pixels])
    random = torch.Generator().manual_seed(0)
    d_weights, d_tau = (torch.randn(len(made.weights), generator=random) for _ in range(2))
    nothing = torch.zeros(23, 38, 3)
    for weights, tau in ((d_weights, d_tau), (d_weights, None), (None, d_tau)):
        found = cpu.backward(ours, ViewGradients(nothing, None, None, made, weights, tau))
        double = (None if x is None else x.double() for x in (weights, tau))
        same_gradients(found, plain.backward(theirs, ViewGradients(nothing.double(), None, None, expected, *double)))


def test_no_pixels_are_made_of_nothing() -> None:
    shown = cpu.rasterise(cloud(20), viewpoint(), SMOOTH)
    made = cpu.contributions(shown, torch.zeros(0, dtype=torch.int64))
    assert made.offsets.tolist() == [0] and not len(made.gaussian)


def test_results_do_not_depend_on_the_threads() -> None:
    gaussians, seen_from, given = cloud(5000, 4, size_m=0.05), viewpoint(70, 101), wanted((70, 101))
    found = []
    for count in (1, 3):
        with threads.limited(count):
            shown = cpu.rasterise(gaussians, seen_from, Drawing(degree=1))
            made = cpu.contributions(shown, torch.arange(0, 7070, 11))
            back = cpu.backward(shown, replace(given, contributions=made, weights=made.weights, tau=made.weights))
        images = [getattr(shown, name) for name in IMAGES]
        found.append([*images, made.alphas, *back.of.tensors().values(), back.screen, back.twist])
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


STRANGE = {
    "none in view": one(means_m=torch.tensor([[50.0, 0.0, 4.0]])),
    "behind the camera": one(means_m=torch.tensor([[0.0, 0.0, -4.0]])),
    "in the camera's plane": one(means_m=torch.tensor([[0.1, 0.0, 0.0]])),
    "the camera is inside": one(means_m=torch.tensor([[0.1, 0.0, 0.3]]), log_scales=sizes(3.0)),
    "a millionth of a metre": one(log_scales=sizes(1e-6)),
    "a million metres": one(log_scales=sizes(1e6)),
    "a needle of a million metres": one(log_scales=torch.tensor([[math.log(1e6), -7.0, -7.0]])),
    "a plane": one(log_scales=torch.tensor([[0.0, 0.0, -math.inf]])),
    "a point": one(log_scales=torch.full((1, 3), -math.inf)),
    "opacity 0": one(opacities=torch.tensor([-math.inf])),
    "opacity 1": one(opacities=torch.tensor([math.inf])),
    "no rotation": one(rotations=torch.zeros(1, 4)),
    "a tiny rotation": one(rotations=torch.full((1, 4), 1e-12)),
    "a huge rotation": one(rotations=torch.full((1, 4), 1e15)),
    "a rotation whose square is infinite": one(rotations=torch.tensor([[1e30, 2e29, -1e29, 3e29]])),
    "a size whose square is infinite": one(log_scales=torch.full((1, 3), math.log(1e30))),
    "far away": one(means_m=torch.tensor([[0.0, 0.0, 1e6]]), log_scales=sizes(6e4)),
    "nothing at all": one().rows(torch.zeros(0, dtype=torch.int64)),
}


@pytest.mark.parametrize("name", STRANGE)
@pytest.mark.parametrize("drawing", [Drawing(), Drawing(compensate=False), Drawing(low_pass_px2=0.0)], ids=str)
def test_strange_gaussians_are_finite_and_equal_the_twin(name: str, drawing: Drawing) -> None:
    gaussians, seen_from, given = STRANGE[name], viewpoint(turned=False), wanted((23, 38))
    ours = cpu.rasterise(gaussians, seen_from, drawing)
    theirs = plain.rasterise(doubled(gaussians), seen_from, drawing)
    same_picture(ours, theirs, 1e-4)
    same_gradients(cpu.backward(ours, given), plain.backward(theirs, doubled_gradients(given)), 1e-3, 1.0)


def test_a_colour_that_is_no_number_is_seen() -> None:
    """And not drawn as black: a fit must find it."""
    gaussians = one()
    gaussians.harmonics[0, 0, 1] = torch.nan
    shown = cpu.rasterise(gaussians, viewpoint(turned=False), SMOOTH)
    middle = shown.rgb[shown.opacity == shown.opacity.max()]
    assert bool(torch.isnan(middle[:, 1]).all()) and bool(torch.isfinite(shown.rgb[..., [0, 2]]).all())


def test_what_is_not_in_view_is_not_listed() -> None:
    gaussians = Gaussians(*(torch.cat(x) for x in zip(*(g.tensors().values() for g in STRANGE.values()), strict=True)))
    index = cpu.rasterise(gaussians, viewpoint(turned=False), Drawing()).index.tolist()
    names = list(STRANGE)
    assert not {"none in view", "behind the camera", "in the camera's plane", "opacity 0"} & {names[i] for i in index}
    assert {"opacity 1", "no rotation", "a million metres"} <= {names[i] for i in index}


def test_equal_depths_are_drawn_in_order() -> None:
    """Many Gaussians at one place: the first is in front."""
    gaussians = one().rows(torch.zeros(50, dtype=torch.int64))
    gaussians.harmonics.copy_(torch.rand(50, 4, 3, generator=torch.Generator().manual_seed(0)))
    seen_from = viewpoint(turned=False)
    same_picture(cpu.rasterise(gaussians, seen_from, SMOOTH), plain.rasterise(gaussians, seen_from, SMOOTH))


def test_a_pixel_that_is_finished_stays_as_it_is() -> None:
    gaussians, seen_from = cloud(400, size_m=0.6), viewpoint()
    whole, soon = (cpu.rasterise(gaussians, seen_from, Drawing(enough=x)) for x in (0.0, 0.1))
    assert 0 < float((whole.opacity - soon.opacity).max()) < 0.1
    assert float((1 - whole.opacity).min()) < 0.01


def test_a_million_gaussians_are_finite_and_equal_the_twin_at_some_pixels() -> None:
    gaussians, seen_from = cloud(1_000_000, size_m=0.004), viewpoint(40, 64, turned=False)
    shown = cpu.rasterise(gaussians, seen_from, Drawing(degree=0))
    back = cpu.backward(shown, wanted((40, 64)))
    assert all(bool(torch.isfinite(x).all()) for x in (shown.rgb, *back.of.tensors().values(), back.twist))
    projected = twin.project(gaussians, seen_from, Drawing(degree=0))
    projected = projected.rows(shown.index)
    projected = projected.rows(torch.sort(projected.z_m, stable=True).indices)
    places = torch.tensor([[0, 0], [30, 20], [63, 39], [31, 3]])
    blended = twin.blend(projected, places.float(), Drawing(degree=0))
    rgb, depth_sum, opacity = twin.sums(projected, blended, Drawing(degree=0))
    column, row = places.unbind(1)
    near(shown.rgb[row, column], rgb, 1e-3, "rgb")
    near(shown.depth_sum[row, column], depth_sum, 1e-3, "depth_sum")
    near(shown.opacity[row, column], opacity, 1e-3, "opacity")


def test_the_median_can_be_left_out() -> None:
    shown = cpu.rasterise(cloud(100), viewpoint(), Drawing(median=False))
    assert not shown.median_m.any() and cpu.rasterise(cloud(100), viewpoint(), Drawing()).median_m.any()


def test_depth_beyond_the_cap_has_no_gradient() -> None:
    """Other than the weight's."""
    gaussians, seen_from = one(), viewpoint(turned=False)
    given = ViewGradients(torch.zeros(23, 38, 3), torch.ones(23, 38))
    by = {
        cap: cpu.backward(cpu.rasterise(gaussians, seen_from, replace(SMOOTH, cap_m=cap)), given) for cap in (3.0, 5.0)
    }
    stopped = cpu.rasterise(gaussians, seen_from, SMOOTH).opacity.sum()
    scaled = by[3.0].of.means_m[0, 2] * (4 / 3)
    torch.testing.assert_close(by[5.0].of.means_m[0, 2] - scaled, stopped, rtol=1e-4, atol=1e-4)


def test_a_quaternion_turns_as_scipy_turns() -> None:
    from scipy.spatial.transform import Rotation

    q = torch.randn(20, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    expected = Rotation.from_quat(q[:, [1, 2, 3, 0]].numpy()).as_matrix()
    np.testing.assert_allclose(twin.turned(q).numpy(), expected, atol=1e-12)


def test_a_ball_is_drawn_as_its_formula_says() -> None:
    """An isotropic Gaussian on the axis: alpha = opacity exp(-r^2 / 2 s^2) s0^2 / s^2, s in pixels."""
    scale_m, low = 0.2, 0.2
    gaussians = one(means_m=torch.tensor([[0.0, 0.0, 4.0]]), log_scales=torch.full((1, 3), math.log(scale_m)))
    K = np.array([[40.0, 0, 10], [0, 40, 8], [0, 0, 1]])
    seen_from = viewpoint(17, 21, turned=False)
    seen_from = seen_from._replace(camera=replace(seen_from.camera, K=K))
    shown = cpu.rasterise(gaussians, seen_from, SMOOTH)
    y, x = np.mgrid[:17, :21]
    raw = (40 * scale_m / 4) ** 2
    opacity = 1 / (1 + math.exp(-0.5)) * raw / (raw + low)
    expected = opacity * np.exp(-0.5 * ((x - 10) ** 2 + (y - 8) ** 2) / (raw + low))
    np.testing.assert_allclose(shown.opacity.numpy(), np.where(expected >= 1e-6, expected, 0), atol=1e-6)
    np.testing.assert_allclose(shown.depth_sum.numpy(), 4 * shown.opacity.numpy(), atol=1e-5)


@pytest.mark.parametrize(
    "wrong",
    [{"degree": 4}, {"enough": 1.0}, {"cap_m": 0.0}, {"near_m": 0.0}, {"least_alpha": 0.0}, {"low_pass_px2": -1}],
)
def test_wrong_drawings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(DataError, match=next(iter(wrong))):
        Drawing(**wrong)  # type: ignore[arg-type]
