"""The fields' stress table: every cell is right, and faults that it found stay mended."""

import numpy as np
import pytest
import torch

from cli.nerf import PROGRAM
from nerf.kernels import cpu_kernels, plain_kernels
from nerf.stress.inputs import INPUTS
from nerf.stress.routines import ROUTINES
from nerf.twin import field as twin_field
from nerf.twin.adam import adam as twin_adam
from nerf.twin.sample import resample
from nerf.types import STEEPEST, Gradients, Histogram, Samples
from priors.stress.routine import Routine
from priors.stress.table import run

pytestmark = pytest.mark.stress
QUICK = [each for each in INPUTS if each.name != "4096 samples"]
LONG = [each for each in INPUTS if each not in QUICK]


@pytest.mark.parametrize("routine", ROUTINES, ids=lambda routine: routine.name)
def test_no_cell_of_the_table_fails(routine: Routine) -> None:
    table = run([routine], QUICK)
    assert table.failures == []
    assert any(each.verdict == "ok" for each in table.cells)


@pytest.mark.slow
def test_no_cell_with_4096_samples_fails() -> None:
    assert run(ROUTINES, LONG).failures == []


def test_what_makes_no_sense_is_said_of_inputs_that_there_are() -> None:
    names = {each.name for each in INPUTS}
    assert len({each.name for each in ROUTINES}) == len(ROUTINES)
    for routine in ROUTINES:
        assert set(routine.senseless) <= names, routine.name
        assert all([*routine.senseless.values(), *routine.other_types.values()]), routine.name


def test_the_command_prints_the_rows_that_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["stress", "--only", "median", "--threads", "1"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("median depth ")


def wall(at: int, count: int = 6) -> tuple[Samples, torch.Tensor]:
    """Samples of a ray of a metre each, and densities of 0.3 1/m with a wall at one of them."""
    offsets, along = torch.tensor([0, count]), torch.arange(count).float()
    ray, table = torch.zeros(count, dtype=torch.int32), torch.zeros(count, dtype=torch.int32)
    places, reach = torch.zeros(count, 3), along / count
    samples = Samples(offsets, ray, along + 1, torch.ones(count), reach, reach + 1 / count, places, table, count)
    sigma = torch.full((count,), 0.3)
    return samples, sigma.index_fill(0, torch.tensor([at]), 1e30)


@pytest.mark.parametrize("density", [1e9, 1e30, float("inf")])
def test_gradients_before_a_wall_are_those_before_any_wall(density: float) -> None:
    samples, sigma = wall(4)
    sigma[4] = density
    rgb, sky = torch.full((6, 3), 0.25), torch.ones(1, 3)
    kernels = cpu_kernels().render
    made = kernels.forward(samples, sigma, rgb, sky)
    pull = Gradients(torch.ones(1, 3), torch.ones(1), torch.zeros(1), torch.zeros(6), torch.zeros(6))
    found = kernels.backward(samples, sigma, rgb, sky, made, pull)[0]
    solid = sigma.clone()
    solid[4] = 60.0
    expected = kernels.backward(samples, solid, rgb, sky, kernels.forward(samples, solid, rgb, sky), pull)[0]
    torch.testing.assert_close(found[:4], expected[:4], rtol=1e-5, atol=0)


def test_adam_moves_a_weight_after_a_gradient_of_any_size() -> None:
    for size in (1e20, 1e30, float("inf")):
        weights, mean, square = torch.zeros(20), torch.zeros(20), torch.zeros(20)
        weights.grad = torch.full((20,), size)
        cpu_kernels().field.adam(weights, mean, square, None, 0.01, 1)
        assert torch.isfinite(square).all()
        torch.testing.assert_close(weights, torch.full((20,), -0.01))
        assert mean[0] == pytest.approx(0.1 * STEEPEST)


def test_adam_keeps_nan_for_all_to_see() -> None:
    for run_adam in (cpu_kernels().field.adam, plain_kernels().field.adam):
        weights, mean, square = torch.zeros(20), torch.zeros(20), torch.zeros(20)
        weights.grad = torch.zeros(20).index_fill(0, torch.tensor([3]), torch.nan)
        run_adam(weights, mean, square, None, 0.01, 1)
        assert torch.isnan(weights).nonzero().tolist() == [[3]]
    with pytest.raises(AssertionError):
        twin_adam(torch.zeros(3), torch.zeros(3), torch.zeros(3), 0.1, 1)


def test_a_nan_in_the_features_is_not_taken_for_empty_space() -> None:
    generator = torch.Generator().manual_seed(0)
    shapes = [(16, 8), (16, 16), (16, 32), (16, 16), (3, 16)]
    layers = twin_field.Layers(*(torch.randn(shape, generator=generator) for shape in shapes))
    features = torch.zeros(4, 64, 2, dtype=torch.bfloat16)
    features[1, 5] = torch.nan
    sigma = cpu_kernels().field.density(features, layers, 0.02)
    assert torch.isnan(sigma).nonzero().tolist() == [[5]]


def test_an_infinite_logit_is_a_density_at_its_limit() -> None:
    assert twin_field._Limited.apply(torch.tensor([torch.inf, 3.0])).tolist() == [twin_field.LOGIT_MAX, 3.0]


def test_rays_without_a_sample_are_resampled_to_nothing() -> None:
    none, room = torch.zeros(4, dtype=torch.int64), torch.zeros(2048)
    samples = Samples(none, room.int() - 1, room, room, room, room, torch.zeros(2048, 3), room.int(), 0)
    targets = torch.linspace(0, 1, 5).expand(3, 5).contiguous()
    for ends in (
        resample(Histogram(samples, room), targets),
        cpu_kernels().sample.resample(Histogram(samples, room), targets),
    ):
        assert np.array_equal(torch.stack(tuple(ends)).numpy(), np.zeros((2, 3, 4)))
