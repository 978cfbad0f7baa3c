"""Convolutions of 8-bit integers: equal to float ones up to the rounding, with ranges that belong to the weights."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from priors.errors import DataError
from priors.kernels.quantise import quantise
from priors.machine import cpu
from priors.nets import int8, runtime, speeds, weights
from priors.nets.blocks import Residual, conv, fold
from priors.nets.fused import FusedResidual, fuse
from priors.nets.int8 import ActivationRange, IntegerConv
from priors.nets.tensors import as_bits

KINDS = pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])


def wide_map(channels: int, low: float, high: float, seed: int = 0) -> torch.Tensor:
    values = torch.rand(1, channels, 12, 20, generator=torch.Generator().manual_seed(seed))
    return (low + (high - low) * values).contiguous(memory_format=torch.channels_last)


@KINDS
@pytest.mark.parametrize("count", [1, 255, 4099])
def test_numbers_are_rounded_to_their_nearest_step(kind: torch.dtype, count: int) -> None:
    values = (torch.randn(count, generator=torch.Generator().manual_seed(count)) * 3).to(kind)
    span, out = ActivationRange(-2.0, 4.0), np.empty(count, np.uint8)
    numbers = torch.tensor([1 / span.scale, span.zero]).numpy()
    quantise(as_bits(values), numbers[0], numbers[1], out, 0, count)
    exact = values.double().numpy() / span.scale + span.zero
    assert (np.abs(out - np.clip(exact, 0, 255)) <= 0.5 + 1e-4).all()


@KINDS
@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-1.0, 0.5)])
@pytest.mark.parametrize("stride", [1, 2])
def test_an_integer_convolution_is_a_convolution(kind: torch.dtype, low: float, high: float, stride: int) -> None:
    if kind == torch.bfloat16 and cpu.mode() not in speeds.FAST_BF16:
        pytest.skip("oneDNN has no bfloat16 results without the instructions, and int8 runs beside float32 there")
    torch.manual_seed(0)
    layer = nn.Conv2d(32, 16, 3, stride, padding=1)
    # The lower half of the steps is used: products of pairs stay within 16 bits on CPUs without VNNI too.
    span = ActivationRange(low, high + 2 * (high - low))
    x = wide_map(32, low, high).to(kind)
    whole = IntegerConv(layer.requires_grad_(False).to(kind), span)
    wanted = torch.relu(layer.float()(x.float()))
    found = whole(x)
    assert found.dtype == kind and found.shape == wanted.shape
    assert float((found.float() - wanted).norm() / wanted.norm()) < 0.03
    plus = torch.randn_like(wanted).to(kind).contiguous(memory_format=torch.channels_last)
    before = plus.clone()
    more = torch.relu(layer(x.float()) + plus.float())
    assert float((whole(x, plus).float() - more).norm() / more.norm()) < 0.03
    assert torch.equal(plus, before)  # what was given is not written to


def test_a_residual_block_hands_bytes_from_one_to_the_other() -> None:
    torch.manual_seed(1)
    block = fold(nn.Sequential(Residual(32)).eval()).requires_grad_(False)
    x = wide_map(32, 0, 1)
    wanted = block(x)
    between = block[0].first(x)
    block[0].first[0].span = ActivationRange(0, 3)
    block[0].second[0].span = ActivationRange(0, 3 * float(between.max()))
    fused = fuse(block)
    assert isinstance(fused[0], FusedResidual) and isinstance(fused[0].second, IntegerConv)
    assert float((fused(x) - wanted).norm() / wanted.norm()) < 0.03


def test_only_what_gains_by_it_is_a_candidate() -> None:
    net = nn.Sequential(conv(32, 32), conv(16, 32), conv(32, 32, 1), nn.Conv2d(32, 32, 3), conv(32, 8))
    assert list(int8.candidates(fold(net.eval()))) == ["0.0"]


@pytest.mark.parametrize("net", ["cfnet", "pcwnet"])
def test_the_ranges_that_ship_are_of_the_weights_that_ship(net: str) -> None:
    path = weights.find(net, "s")
    folded = fold(runtime.create(net, "s").eval())
    assert set(int8.read(path)) == set(int8.candidates(folded)) and int8.candidates(folded)
    assert all(span.low <= 0 < span.high and 0 <= span.zero <= 255 for span in int8.read(path).values())
    assert int8.digest(path) != weights.digest(path)


def test_ranges_of_other_weights_are_refused_in_a_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.safetensors"
    file.write_bytes(weights.find("cfnet", "s").read_bytes())
    with pytest.raises(DataError, match=r"mine.int8.json: no ranges for int8: make them"):
        int8.read(file)
    int8.beside(file).write_text(int8.beside(weights.find("pcwnet", "s")).read_text())
    with pytest.raises(DataError, match="ranges of other weights"):
        int8.read(file)
    assert not int8.runs("cfnet", "s", file)


def test_it_is_refused_where_products_would_overflow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu, "features", lambda: frozenset({"avx512f"}))
    assert not int8.available() and not int8.runs("cfnet", "s")
    with pytest.raises(DataError, match="no VNNI"):
        runtime.choose("int8", net="cfnet")
    with pytest.raises(DataError, match=r"no VNNI|stereo networks alone"):
        runtime.choose_floating("int8", net="bts")


def test_auto_takes_it_where_it_is_fastest_and_can_run(monkeypatch: pytest.MonkeyPatch) -> None:
    ratios = {"bf16": 3.0, "fp32": 5.0, "int8": 2.0}
    monkeypatch.setattr(speeds, "table", lambda: {"modes": {"avx512": {"ratios": {"cfnet": ratios}}}})
    assert speeds.fastest("avx512", "cfnet", integers=True) == "int8"
    assert speeds.fastest("avx512", "cfnet", integers=False) == "bf16"


@pytest.mark.skipif(not int8.available(), reason="this CPU mode has no VNNI: int8 is refused there")
def test_a_network_on_integers_finds_what_the_other_finds(tmp_path: Path) -> None:
    torch.manual_seed(3)
    left = torch.rand(1, 3, 96, 160)
    right = torch.roll(left, -6, dims=3)
    found = {}
    for how in ("fp32", "int8"):
        found[how] = runtime.as_map(runtime.open_net("cfnet", "s", how)(left, right, largest_px=64).disparity_px)
    off = np.abs(found["int8"] - found["fp32"])
    assert np.median(off) < 0.05 and off.any()
