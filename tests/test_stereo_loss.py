"""What a stereo network's loss is made of: truth of coarser pixels, and the error of depth."""

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from priors.learn.stereo import FARTHER, FIGURES, LEAST_PX, StereoTask, coarser, depth_error
from priors.learn.stereo_pair import StereoPair
from priors.nets import runtime

pytestmark = pytest.mark.networks
whatever_the_load = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])


def away(at: tuple[int, ...], step: int) -> int:
    """Squared distance from a cell's middle."""
    return sum((place - step // 2) ** 2 for place in at)


def coarser_by_loops(truth: np.ndarray, weight: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixel of the greatest weight of each cell, of equal ones the nearest to the middle."""
    shape = truth.shape[0], truth.shape[1] // step, truth.shape[2] // step
    values, sure = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for b, row, column in np.ndindex(shape):
        window = np.s_[b, row * step : (row + 1) * step, column * step : (column + 1) * step]
        best = max(np.ndindex(step, step), key=lambda at: (weight[window][at], -away(at, step)))
        values[b, row, column], sure[b, row, column] = truth[window][best], weight[window][best]
    return values, sure


@whatever_the_load
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 4, 8]), st.sampled_from([0.0, 0.02, 0.2, 1.0]))
def test_a_cell_has_the_truth_of_its_best_known_pixel(seed: int, step: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(1, 90, (2, 16, 24)).astype(np.float32)
    weight = (rng.choice([0.2, 1.0], truth.shape) * (rng.random(truth.shape) < share)).astype(np.float32)
    values, sure = coarser(torch.from_numpy(truth), torch.from_numpy(weight), step)
    _, expected_sure = coarser_by_loops(truth, weight, step)
    assert np.array_equal(sure.numpy(), expected_sure)
    known = expected_sure > 0
    # Pixels of one weight that are equally far from the middle are as good as each other.
    cells = truth.reshape(2, 16 // step, step, 24 // step, step).transpose(0, 1, 3, 2, 4).reshape(*known.shape, -1)
    assert all(value in cell for value, cell in zip(values.numpy()[known], cells[known], strict=True))
    middles = truth[:, step // 2 :: step, step // 2 :: step], weight[:, step // 2 :: step, step // 2 :: step]
    sole = known & (middles[1] == expected_sure)
    assert np.array_equal(values.numpy()[sole], middles[0][sole])  # the middle itself has no equal


def test_where_all_is_known_the_middle_counts() -> None:
    truth = torch.rand(2, 32, 48)
    for step in (2, 4, 8):
        values, sure = coarser(truth, torch.ones_like(truth), step)
        assert torch.equal(values, truth[:, step // 2 :: step, step // 2 :: step]) and bool((sure == 1).all())


@whatever_the_load
@given(st.floats(LEAST_PX + 0.1, 150), st.floats(0.3, 3.5))
def test_the_slope_is_that_of_depth_s_relative_error(truth_px: float, ratio: float) -> None:
    disparity = torch.tensor(max(truth_px / ratio, LEAST_PX + 0.05), dtype=torch.float64, requires_grad=True)
    if ratio > FARTHER or abs(ratio - 1) < 1e-3:
        return
    truth = torch.tensor(truth_px, dtype=torch.float64)
    (slope,) = torch.autograd.grad(depth_error(disparity, truth), disparity)
    (expected,) = torch.autograd.grad((truth / disparity - 1).abs(), disparity)
    torch.testing.assert_close(slope, expected)


def test_the_slope_stays_finite_and_the_sky_has_none() -> None:
    disparity = torch.tensor([0.0, 0.0, 1e-6, 190.0], requires_grad=True)
    truth = torch.tensor([0.0, 190.0, 40.0, 1.0])
    error = depth_error(disparity, truth)
    error.sum().backward()
    assert disparity.grad is not None and bool(torch.isfinite(disparity.grad).all())
    assert disparity.grad[0] == 0 and error[0] == 0
    assert disparity.grad[1] < 0 < disparity.grad[3]  # towards the truth
    near_as_far, far_as_near = depth_error(torch.tensor([5.0, 40.0]), torch.tensor([40.0, 5.0]))
    assert near_as_far > 10 * far_as_near


def test_validation_leaves_weak_labels_and_the_sky_out() -> None:
    torch.manual_seed(0)
    net = runtime.create("cfnet", "s").eval()
    rng = np.random.default_rng(0)
    view = rng.integers(0, 256, (64, 96, 3), dtype=np.uint8)
    sky, weight = np.zeros((64, 96), bool), np.zeros((64, 96), np.float32)
    sky[:20], weight[:20], weight[30:], weight[50:] = True, 1.0, 0.2, 1.0
    disparity_px = np.where(weight > 0, np.float32(8), np.float32(0)) * ~sky
    found = []
    for weak_px in (8.0, 80.0):
        values = np.where(weight == np.float32(0.2), np.float32(weak_px), disparity_px).astype(np.float32)
        task = StereoTask(net, None, [StereoPair(view, view, values, sky, weight, "mine")])  # type: ignore[arg-type]
        found.append(task.validate(net))
    assert found[0] == found[1] and set(found[0]) == {"error", *(f"mine {name}" for name in FIGURES)}
