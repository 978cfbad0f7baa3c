"""The hash grid: kernels equal the twin, rows are in range, sums do not depend on threads."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import NumbaError

from nerf.grid import Grid
from nerf.kernels.cpu import field as cpu
from nerf.kernels.cpu.lanes import load_int
from nerf.kernels.words import flat, words
from nerf.twin import encode as twin
from nerf.types import GridConfig, level_shapes
from priors.errors import DataError
from priors.machine import threads
from priors.machine.compiled import compiled

CPU = torch.device("cpu")
CONFIGS = {
    "usual": GridConfig(levels=6, log2_size=12, coarsest=4, finest=300),
    "two tables": GridConfig(levels=3, log2_size=9, coarsest=5, finest=64, tables=2),
    "all fit": GridConfig(levels=4, log2_size=15, coarsest=3, finest=24),
    "none fits": GridConfig(levels=2, log2_size=5, coarsest=40, finest=2048),
    "one level": GridConfig(levels=1, log2_size=14, coarsest=16, finest=16),
}
EVERY = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def made(config, count=160, seed=0):
    """Return weights rounded to bfloat16, places, tables."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.randn(config.tables, config.rows, 2, generator=generator).bfloat16()
    u = torch.rand(count, 3, generator=generator)
    return weights, u, torch.randint(config.tables, (count,), generator=generator, dtype=torch.int32)


def row_of(x, y, z, shape):
    """Return the corners' rows in their level."""
    _, stride_y, stride_z, shift, mask, _ = shape
    number = (x + stride_y * y + stride_z * z) & 0xFFFFFFFF
    return (number ^ (number >> shift)) & mask & 0xFFFFFFFF


def close_to_bfloat16(found, exact):
    """Within half a unit of bfloat16's last place, and what float32 sums lose."""
    return bool(((found.double() - exact).abs() <= exact.abs() * 2**-8 + 2e-6).all())


@EVERY
@pytest.mark.parametrize("spread", [None, 1e-4, 0.02, 1.0])
def test_features_equal_the_twin(config, spread):
    weights, u, table = made(config)
    footprint = None if spread is None else torch.full((len(u),), spread) * torch.rand(len(u))
    found = cpu.encode(u, table, footprint, weights, config)
    exact = twin.encode(u, table, footprint, weights.double(), config)
    assert found.shape == (config.levels, len(u), 2)
    assert close_to_bfloat16(found, exact)


@EVERY
@pytest.mark.parametrize("spread", [None, 0.02])
def test_gradient_equals_the_twin(config, spread):
    weights, u, table = made(config)
    footprint = None if spread is None else torch.full((len(u),), spread)
    d_features = torch.randn(config.levels, len(u), 2).bfloat16()
    found = torch.full_like(weights, 7, dtype=torch.float32)  # what was there before does not count
    cpu.spread(u, table, footprint, d_features, config, found)
    exact = weights.double().requires_grad_()
    twin.encode(u, table, footprint, exact, config).backward(d_features.double())
    torch.testing.assert_close(found.double(), exact.grad, rtol=1e-5, atol=2e-6)


borders = st.integers(0, 300).map(lambda i: i / 300)
coordinates = st.one_of(st.floats(0, 1, width=32), borders, st.sampled_from([0.0, 1.0, float(np.float32(1) - 2**-24)]))


@settings(deadline=None, max_examples=60)
@given(place=st.tuples(coordinates, coordinates, coordinates))
def test_any_place_equals_the_twin(place):
    config = CONFIGS["usual"]
    weights, _, _ = made(config)
    u = torch.tensor([place] * 16, dtype=torch.float32)
    table = torch.zeros(16, dtype=torch.int32)
    found = cpu.encode(u, table, None, weights, config)
    assert close_to_bfloat16(found, twin.encode(u, table, None, weights.double(), config))
    gradient = torch.zeros(1, config.rows, 2)
    cpu.spread(u, table, None, torch.ones_like(found), config, gradient)
    # the 8 shares of a cell add up to 1, for 16 samples, 2 features and every level
    assert gradient.sum() == pytest.approx(16 * 2 * config.levels, rel=1e-5)


@EVERY
def test_corners_give_the_weights_themselves(config):
    weights, _, _ = made(config)
    u = torch.tensor(list(itertools.product((0.0, 1.0), repeat=3)) * 2)
    table = torch.zeros(16, dtype=torch.int32)
    found = cpu.encode(u, table, None, weights, config)
    for level, shape in enumerate(config.shapes.tolist()):
        row = shape[-1] + row_of(*(u.long() * shape[0]).unbind(-1), shape)
        torch.testing.assert_close(found[level], weights[0, row], rtol=0, atol=0)


def test_features_are_continuous_across_cells():
    config = CONFIGS["usual"]
    weights, _, _ = made(config)
    line = torch.rand(16, 3).double()
    for resolution in config.shapes[:, 0]:
        line[:, 0] = torch.arange(16) % resolution / resolution
        sides = [(line + torch.tensor([step, 0, 0])).clamp(0, 1).float() for step in (-1e-6, 1e-6)]
        one, other = (cpu.encode(u, torch.zeros(16, dtype=torch.int32), None, weights, config).float() for u in sides)
        torch.testing.assert_close(one, other, rtol=2**-7, atol=0.01)


def test_gradients_that_lie_elsewhere_in_memory_are_the_same():
    """Autograd leaves gradients with strides (2, 12, 1): read as flat words they would go to the wrong rows."""
    config = CONFIGS["usual"]
    weights, u, table = made(config, count=320)
    d_features = torch.randn(len(u), config.levels, 2).permute(1, 0, 2)
    assert not d_features.is_contiguous()
    one, other = torch.empty(weights.shape), torch.empty(weights.shape)
    cpu.spread(u, table, None, d_features, config, one)
    cpu.spread(u, table, None, d_features.contiguous(), config, other)
    assert torch.equal(one, other) and one.any()


@pytest.mark.parametrize(
    "pairs",
    [torch.zeros(4, 3, 2).bfloat16().permute(1, 0, 2), torch.zeros(4, 2), torch.zeros(4, 3).bfloat16()],
    ids=["strides", "float32", "threes"],
)
def test_words_are_flat_pairs_of_bfloat16(pairs):
    with pytest.raises(ValueError, match="expected contiguous pairs of bfloat16, found"):
        words(pairs)
    assert words(flat(pairs[..., :2])).is_contiguous()


def test_lanes_take_flat_contiguous_arrays_only():
    @compiled
    def first(array):
        return load_int(array, np.int64(0))

    numbers = np.arange(16, dtype=np.int32)
    assert first(numbers[3:]) == 3
    with pytest.raises(NumbaError, match="flat contiguous array"):
        first(numbers[::2])


def test_same_bits_whatever_the_threads():
    config = CONFIGS["usual"]
    weights, u, table = made(config, count=4096)
    d_features = torch.randn(config.levels, len(u), 2).bfloat16()
    results = []
    for count in (1, 2, 5):
        with threads.limited(count):
            gradient = torch.empty(weights.shape)
            cpu.spread(u, table, None, d_features, config, gradient)
            results.append((cpu.encode(u, table, None, weights, config), gradient))
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))


@EVERY
def test_rows_of_levels_do_not_meet(config):
    shapes, rows = level_shapes(config)
    ends = [*shapes[1:, 5].tolist(), rows]
    for shape, end in zip(shapes.tolist(), ends, strict=True):
        row = row_of(*np.meshgrid(*[np.arange(min(shape[0], 48) + 1, dtype=np.int64)] * 3, indexing="ij"), shape)
        assert row.min() >= 0 and shape[5] + row.max() < end
        if shape[4] == -1:
            assert len(np.unique(row)) == row.size  # a level that fits gives every corner its own row


@pytest.mark.parametrize("log2_size", [15, 17, 19])
def test_rows_are_used_evenly(log2_size):
    config = GridConfig(levels=1, log2_size=log2_size, coarsest=2048, finest=2048)
    plane = np.meshgrid(np.arange(400), [700], np.arange(400), indexing="ij")  # a ground plane's corners
    row = row_of(*(axis.astype(np.int64) for axis in plane), config.shapes[0].tolist())
    load = row.size / (1 << log2_size)
    used = len(np.unique(row)) / (1 << log2_size)
    assert used > 0.9 * (1 - np.exp(-load))  # as good as a random choice


def test_large_footprints_see_only_coarse_levels():
    config = GridConfig(levels=4, log2_size=14, coarsest=4, finest=1024)
    weights, u, table = made(config)
    point = cpu.encode(u, table, None, weights, config).float().abs().mean((1, 2))
    blurred = cpu.encode(u, table, torch.full((len(u),), 0.02), weights, config).float().abs().mean((1, 2))
    kept = (blurred / point).tolist()
    assert kept == sorted(kept, reverse=True) and kept[0] > 0.99 and kept[-1] < 0.05
    tiny = cpu.encode(u, table, torch.full((len(u),), 1e-7), weights, config)
    assert torch.equal(tiny, cpu.encode(u, table, None, weights, config))


def test_the_copy_follows_the_weights():
    config = CONFIGS["one level"]
    grid = Grid(config, CPU, torch.Generator().manual_seed(0), cpu)
    u, table = torch.rand(16, 3), torch.zeros(16, dtype=torch.int32)
    before = grid.encode(u, table)
    grid.weights.add_(1)
    assert (grid.encode(u, table).float() - before.float() - 1).abs().max() < 0.01


@pytest.mark.parametrize("wrong", [{"levels": 17}, {"levels": 0}, {"coarsest": 99, "finest": 10}, {"tables": 0}])
def test_wrong_sizes_are_told(wrong):
    with pytest.raises(DataError, match="expected"):
        GridConfig(**wrong)
