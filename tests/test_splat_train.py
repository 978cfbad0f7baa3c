"""Adam for the Gaussians in view, and the loss of colours: against their twins, scikit-image and differences."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from nerf.gaussians.types import NAMES, Gaussians, Rates, SplatGradients, SplatMoments
from nerf.kernels.cpu import splat as cpu
from nerf.kernels.plain import splat as plain
from nerf.twin import colour_loss as twin
from priors.machine import threads
from tests.splats import cloud

pytestmark = pytest.mark.splats
RATES = Rates(0.06, 0.03, 0.02, 0.1, 0.05, 0.005)


def pictures(height: int, width: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(seed)
    truth = torch.rand(height, width, 3, generator=random)
    return (truth + 0.2 * torch.randn(height, width, 3, generator=random)).clamp(-0.1, 1.2), truth


SIZES = [(11, 11), (12, 31), (40, 27), (30, 64), (25, 43)]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("weighted", [False, True])
def test_the_loss_and_its_derivative_equal_the_twin(size: tuple[int, int], weighted: bool) -> None:
    rgb, truth = pictures(*size)
    weight = torch.rand(size, generator=torch.Generator().manual_seed(2)) if weighted else None
    ours = cpu.colour_loss(rgb, truth, 0.2, weight)
    double = None if weight is None else weight.double()
    theirs = plain.colour_loss(rgb.double(), truth.double(), 0.2, double)
    np.testing.assert_allclose(ours[:3], theirs[:3], rtol=1e-5)
    scale = float(theirs.d_rgb.abs().max())
    torch.testing.assert_close(ours.d_rgb, theirs.d_rgb.float(), rtol=0, atol=2e-5 * scale)


def test_ssim_is_that_of_scikit_image() -> None:
    rgb, truth = pictures(40, 53)
    expected = structural_similarity(
        rgb.double().numpy(), truth.double().numpy(), channel_axis=2, data_range=1.0,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    )  # fmt: skip
    assert math.isclose(1 - cpu.colour_loss(rgb, truth, 0.2).dissimilarity, expected, abs_tol=2e-6)
    assert math.isclose(float(twin.ssim(rgb.double(), truth.double()).mean()), expected, abs_tol=1e-9)


def test_the_derivative_is_that_of_differences_of_scikit_image() -> None:
    rgb, truth = (x.double() for x in pictures(14, 17))
    share, step, found = 0.3, 1e-5, cpu.colour_loss(rgb.float(), truth.float(), 0.3).d_rgb

    def loss(picture: np.ndarray) -> float:
        ssim = structural_similarity(
            picture, truth.numpy(), channel_axis=2, data_range=1.0,
            gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        )  # fmt: skip
        return (1 - share) * float(np.abs(picture - truth.numpy()).mean()) + share * (1 - ssim)

    for place in [(0, 0, 0), (5, 5, 1), (6, 8, 2), (13, 16, 0), (8, 3, 1)]:
        values = []
        for sign in (1, -1):
            changed = rgb.numpy().copy()
            changed[place] += sign * step
            values.append(loss(changed))
        assert math.isclose(float(found[place]), (values[0] - values[1]) / (2 * step), rel_tol=1e-3, abs_tol=1e-7)


def test_equal_pictures_cost_nothing() -> None:
    _, truth = pictures(20, 30)
    found = cpu.colour_loss(truth, truth, 0.2)
    assert abs(found.total) < 1e-6 and float(found.d_rgb.abs().max()) < 1e-7


def test_without_ssim_any_size_will_do() -> None:
    rgb, truth = pictures(3, 5)
    found = cpu.colour_loss(rgb, truth, 0.0)
    assert math.isclose(found.total, float((rgb - truth).abs().mean()), rel_tol=1e-5)
    torch.testing.assert_close(found.d_rgb, (rgb - truth).sign() / 45)
    for kernels in (cpu, plain):
        with pytest.raises(ValueError, match="11 x 11"):
            kernels.colour_loss(rgb, truth, 0.2)


def test_the_loss_does_not_depend_on_the_threads() -> None:
    rgb, truth = pictures(70, 90)
    found = []
    for count in (1, 3):
        with threads.limited(count):
            found.append(cpu.colour_loss(rgb, truth, 0.2))
    assert found[0][:3] == found[1][:3] and torch.equal(found[0].d_rgb, found[1].d_rgb)


def gradients_of(gaussians: Gaussians, coefficients: int) -> SplatGradients:
    """Return made-up gradients of every third Gaussian."""
    random = torch.Generator().manual_seed(4)
    index = torch.arange(0, len(gaussians), 3)
    shapes = [(len(index), *x.shape[1:]) for x in gaussians.tensors().values()]
    shapes[-1] = (len(index), coefficients, 3)
    of = Gaussians(*(torch.randn(shape, generator=random) for shape in shapes))
    return SplatGradients(index, of, torch.zeros(len(index)), torch.zeros(6))


@pytest.mark.parametrize(("stored", "drawn"), [(1, 1), (4, 1), (16, 4), (16, 16), (9, 9)])
def test_adam_equals_the_twin(stored: int, drawn: int) -> None:
    """The others keep their parameters and moments, bit for bit."""
    found, before = [], cloud(1000, stored)
    for kernels in (cpu, plain):
        gaussians = before.rows(torch.arange(1000))
        moments = SplatMoments(gaussians.zeros(), gaussians.zeros(), torch.linspace(0.01, 1, 1000))
        for step in (1, 2, 3):
            kernels.adam(gaussians, gradients_of(gaussians, drawn), moments, RATES, step)
        found.append((gaussians, moments))
    (ours, own), (theirs, other) = found
    others = torch.ones(1000, dtype=torch.bool)
    others[::3] = False
    for name in NAMES:
        for a, b in ((ours, theirs), (own.mean, other.mean), (own.square, other.square)):
            torch.testing.assert_close(getattr(a, name), getattr(b, name), rtol=2e-5, atol=2e-6)
        assert torch.equal(getattr(ours, name)[others], getattr(before, name)[others])
        assert not getattr(own.mean, name)[others].any()
    torch.testing.assert_close(torch.linalg.vector_norm(ours.rotations[::3], dim=1), torch.ones(334))
    assert not torch.equal(ours.harmonics[::3, :drawn], before.harmonics[::3, :drawn])
    assert torch.equal(ours.harmonics[:, drawn:], before.harmonics[:, drawn:])


def test_adam_does_not_write_beside_its_rows() -> None:
    """Parameters that are views of a larger array keep their neighbours."""
    gaussians = cloud(7, 1)
    wide = torch.full((9, 3), 5.0)
    wide[1:8] = gaussians.means_m
    inside = Gaussians(wide[1:8], *list(gaussians.tensors().values())[1:])
    moments = SplatMoments(inside.zeros(), inside.zeros(), torch.ones(7))
    cpu.adam(inside, gradients_of(inside, 1), moments, RATES, 1)
    assert bool((wide[[0, 8]] == 5).all())


def test_steps_find_a_picture() -> None:
    """Gaussians of wrong colours and places come to look like others."""
    from nerf.gaussians.types import Drawing, ViewGradients
    from tests.splats import viewpoint

    seen_from, drawing = viewpoint(turned=False), Drawing(degree=0)
    truth = cpu.rasterise(cloud(60, seed=1), seen_from, drawing).rgb
    gaussians = cloud(60, seed=1)
    gaussians.harmonics.mul_(0.2)
    gaussians.means_m.add_(0.05)
    moments = SplatMoments(gaussians.zeros(), gaussians.zeros(), torch.full((60,), 0.1))
    losses = []
    for step in range(1, 61):
        shown = cpu.rasterise(gaussians, seen_from, drawing)
        loss = cpu.colour_loss(shown.rgb, truth, 0.2)
        losses.append(loss.total)
        cpu.adam(gaussians, cpu.backward(shown, ViewGradients(loss.d_rgb)), moments, RATES, step)
    assert losses[-1] < 0.25 * losses[0]
