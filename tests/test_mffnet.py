"""The completion network: what it promises for any input, and the method around it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from priors.errors import DataError
from priors.machine import threads
from priors.methods._completion_classical import list_samples, near_samples
from priors.methods._completion_network import span
from priors.methods.completion import Completion, complete
from priors.nets import runtime, weights
from priors.nets.blocks import channels_last, fold
from priors.nets.fused import available
from priors.nets.mffnet import LARGEST_CHANGE, SIZES, Mffnet, correct, correct_fast, describe, exchange
from priors.types import Camera, Depth, FloatMap

F = np.float32
SIZE = (75, 140)
CAMERA = Camera(np.array([[100.0, 0, 70], [0, 100, 30], [0, 0, 1]]), SIZE)
T_CAM_LIDAR = np.array([[0, -1.0, 0, 0.06], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with threads.limited(1):
        yield


def network(seed: int = 0, loud: float = 0.05) -> Mffnet:
    """A small network that changes something: the head is not zero, the norms are not neutral."""
    torch.manual_seed(seed)
    net = Mffnet("s").eval()
    torch.nn.init.normal_(net.head.weight, std=loud)
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.normal_(module.running_mean, std=0.1)
            torch.nn.init.uniform_(module.running_var, 0.5, 1.5)
    return net


def inputs(size: tuple[int, int] = SIZE, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """Image, pre-fill, confidence and samples of a road."""
    torch.manual_seed(seed)
    fill_m = (100 / (torch.arange(size[0]) + 5.0))[None, :, None].repeat(1, 1, size[1])
    sparse_m = torch.where(torch.rand(1, *size) < 0.05, fill_m * 1.02, 0.0)
    return torch.rand(1, 3, *size), fill_m, torch.rand(1, *size), sparse_m


@pytest.fixture
def method(tmp_path: Path) -> Completion:
    """The method with a network of random weights."""
    path = tmp_path / "mffnet-s.safetensors"
    weights.write(path, network(), {"net": "mffnet", "size": "s"})
    return Completion(model="mffnet", size="s", runtime="fp32", weights=path)


def road(size: tuple[int, int] = SIZE) -> FloatMap:
    return np.repeat(F(165) / (np.arange(size[0], dtype=F)[:, None] + 3), size[1], axis=1)


def image(size: tuple[int, int] = SIZE, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*size, 3)).astype(np.uint8)


# --- the network


@pytest.mark.parametrize("size", SIZES)
def test_an_untrained_network_returns_the_pre_fill(size: str) -> None:
    given = inputs()
    with torch.inference_mode():
        found = Mffnet(size).eval()(*given)
    torch.testing.assert_close(found.depth_m, given[1])
    assert found.branches_m == ()


@pytest.mark.parametrize("size", [(1, 1), (31, 33), (64, 96), (75, 140)])
def test_any_size(size: tuple[int, int]) -> None:
    given = inputs(size)
    with torch.inference_mode():
        found = network()(*given)
    assert found.depth_m.shape == found.log_scale.shape == (1, *size)
    assert torch.isfinite(found.depth_m).all() and torch.isfinite(found.log_scale).all()


def test_only_ratios_of_depths_matter() -> None:
    image_, fill_m, certain, sparse_m = inputs()
    net = network()
    with torch.inference_mode():
        near, far = net(image_, fill_m, certain, sparse_m), net(image_, 8 * fill_m, certain, 8 * sparse_m)
    assert (near.depth_m - fill_m).abs().max() > 1e-3
    torch.testing.assert_close(8 * near.depth_m, far.depth_m, rtol=1e-4, atol=0)
    torch.testing.assert_close(near.log_scale, far.log_scale, rtol=0, atol=1e-3)


def test_the_change_is_bounded() -> None:
    given = inputs()
    with torch.inference_mode():
        found = network(loud=50.0)(*given)
    change = (found.depth_m / given[1]).log().abs()
    assert change.max() > 1
    assert change.max() <= LARGEST_CHANGE + 1e-4


def test_the_result_lies_between_the_branches() -> None:
    net = network().train()
    found = net(*(torch.cat([value, value.flip(-1)]) for value in inputs()))
    first, second = found.branches_m
    assert (first - second).abs().max() > 1e-3
    low, high = torch.minimum(first, second), torch.maximum(first, second)
    assert ((found.depth_m >= low * 0.9999) & (found.depth_m <= high * 1.0001)).all()


@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])
def test_the_kernel_of_the_last_step_equals_plain_torch(kind: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    raw = (20 * torch.randn(2, 16, 5, 7, generator=generator)).to(kind).to(memory_format=torch.channels_last)
    log_fill = torch.randn(2, 9, 13, generator=generator)  # smaller than the padded 10 x 14
    with torch.no_grad():
        ours, twin = correct_fast(raw, log_fill), correct(raw, log_fill, branches=False)
    for found, expected in zip(ours, twin, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-6, rtol=2e-6)


def test_both_modalities_matter() -> None:
    image_, fill_m, certain, sparse_m = inputs()
    net = network()
    with torch.inference_mode():
        base = net(image_, fill_m, certain, sparse_m).depth_m
        others = [
            net(1 - image_, fill_m, certain, sparse_m),
            net(image_, fill_m, 1 - certain, sparse_m),
            net(image_, fill_m, certain, torch.zeros_like(sparse_m)),
        ]
    assert all((other.depth_m - base).abs().max() > 1e-4 for other in others)


def test_exchange_swaps_halves() -> None:
    a, b = torch.arange(4.0).view(1, 4, 1, 1), 10 + torch.arange(4.0).view(1, 4, 1, 1)
    first, second = exchange(a, b)
    assert first.flatten().tolist() == [0, 1, 12, 13]
    assert second.flatten().tolist() == [10, 11, 2, 3]
    again = exchange(first, second)
    assert torch.equal(again[0], a) and torch.equal(again[1], b)


def test_describe_says_what_the_fill_left_out() -> None:
    _, fill_m, certain, sparse_m = inputs()
    found = describe(fill_m.log(), certain, sparse_m, torch.float32)
    there = sparse_m[0] > 0
    assert abs(float(found[0, 0].mean())) < 1e-5
    assert torch.equal(found[0, 2] == 1, there)
    torch.testing.assert_close(found[0, 3][there], torch.full((int(there.sum()),), 4 * float(np.log(1.02))))
    assert (found[0, 3][~there] == 0).all()


@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])
def test_fused_is_the_same(kind: torch.dtype) -> None:
    if not available(kind):
        pytest.skip("this torch, or this CPU, has no fused operators for this kind of numbers")
    plain = channels_last(fold(network()).requires_grad_(False).to(torch.bfloat16).to(kind))
    given = inputs()
    before = runtime.Ready(plain, "fp32", {})(*given)
    ready = runtime.make_ready(network(), "bf16" if kind == torch.bfloat16 else "fp32")
    after = ready(*given)
    assert any("Fused" in type(module).__name__ for module in ready.net.modules())
    limit = 0.02 if kind == torch.bfloat16 else 1e-5
    assert (before.depth_m - given[1]).abs().max() > 0.01
    assert ((before.depth_m / after.depth_m).log().abs() < limit).all()


def test_bf16_is_close_to_fp32() -> None:
    given = inputs()
    exact, quick = (runtime.make_ready(network(), kind)(*given) for kind in ("fp32", "bf16"))
    change = (exact.depth_m / given[1]).log().abs().mean()
    assert (exact.depth_m / quick.depth_m).log().abs().mean() < 0.1 * change


def test_a_size_that_is_not_there() -> None:
    with pytest.raises(DataError, match="sizes s, m, not l"):
        Mffnet("l")


# --- the method


def mended(method: Completion, sparse_m: FloatMap, picture: np.ndarray | None = None) -> Depth:
    picture = image(sparse_m.shape) if picture is None else picture
    K = CAMERA.K.copy()
    return method.fill(sparse_m, picture, Camera(K, sparse_m.shape), T_CAM_LIDAR)


def check(depth: Depth, sparse_m: FloatMap, reach_px: int = 64) -> None:
    """What is promised for any input: finite, bounded by the samples, a value near samples and nowhere else."""
    assert depth.confidence is not None
    assert depth.depth_m.shape == depth.confidence.shape == sparse_m.shape
    assert np.isfinite(depth.depth_m).all() and np.isfinite(depth.confidence).all()
    assert np.array_equal(depth.valid, near_samples(list_samples(sparse_m), sparse_m.shape, reach_px))
    assert ((depth.confidence > 0) == depth.valid).all() and depth.confidence.max(initial=0) <= 1
    samples = sparse_m[sparse_m > 0]
    if samples.size:
        values = depth.depth_m[depth.valid]
        assert samples.min() * 0.799 <= values.min() and values.max() <= samples.max() * 1.251


def test_no_sample_gives_no_value(method: Completion) -> None:
    depth = mended(method, np.zeros(SIZE, F))
    assert not depth.valid.any()
    assert depth.confidence is not None and not depth.confidence.any()


@pytest.mark.parametrize("at", [(0, 0), (74, 139), (40, 70)])
def test_one_sample(method: Completion, at: tuple[int, int]) -> None:
    sparse_m = np.zeros(SIZE, F)
    sparse_m[at] = 12.5
    check(mended(method, sparse_m), sparse_m)


@pytest.mark.parametrize("line", [(slice(30, 31), slice(None)), (slice(None), slice(7, 8))])
def test_all_samples_on_one_line(method: Completion, line: tuple[slice, slice]) -> None:
    sparse_m = np.zeros(SIZE, F)
    sparse_m[line] = road()[line]
    check(mended(method, sparse_m), sparse_m)


@pytest.mark.parametrize("size", [(12, 9), (40, 400), (300, 60)])
@pytest.mark.parametrize("metres", [0.05, 1.0, 50.0])
def test_other_aspect_ratios_and_ranges(method: Completion, size: tuple[int, int], metres: float) -> None:
    sparse_m = np.where(np.random.default_rng(0).random(size) < 0.08, road(size) * F(metres), F(0))
    sparse_m[0, 0] = 9 * metres
    check(mended(method, sparse_m), sparse_m)


def test_what_is_no_sample(method: Completion) -> None:
    sparse_m = np.where(np.random.default_rng(1).random(SIZE) < 0.08, road(), F(0))
    spoilt = sparse_m.copy()
    spoilt[3, 4], spoilt[5, 6], spoilt[7, 8], spoilt[9, 9], spoilt[11, 3] = np.nan, np.inf, -4, 1e-9, 1e9
    sparse_m[[3, 5, 7, 9, 11], [4, 6, 8, 9, 3]] = 0
    ours, theirs = mended(method, spoilt), mended(method, sparse_m)
    assert np.array_equal(ours.depth_m, theirs.depth_m)


def test_grey_images_and_flat_images(method: Completion) -> None:
    sparse_m = np.where(np.random.default_rng(1).random(SIZE) < 0.08, road(), F(0))
    grey = image()[..., 0]
    ours = mended(method, sparse_m, grey)
    theirs = mended(method, sparse_m, np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_allclose(ours.depth_m, theirs.depth_m, rtol=1e-4)
    for value in (0, 255):
        check(mended(method, sparse_m, np.full((*SIZE, 3), value, np.uint8)), sparse_m)


def test_rows_without_samples_are_left_out_of_the_work(method: Completion) -> None:
    sparse_m = np.zeros((300, 140), F)
    sparse_m[220:, ::3] = road((300, 140))[220:, ::3]
    depth = mended(method, sparse_m)
    check(depth, sparse_m)
    assert not depth.valid[:150].any() and depth.valid[160:].all()


def test_rows_come_in_multiples_of_32_where_there_are_enough() -> None:
    near = np.zeros((100, 10), bool)
    near[40:60] = True
    assert span(near) == slice(28, 60)
    near[90] = True
    assert span(near) == slice(27, 91)
    near[5] = True
    assert span(near) == slice(0, 91)


def test_an_untrained_network_is_the_classical_method(tmp_path: Path) -> None:
    path = tmp_path / "mffnet-s.safetensors"
    weights.write(path, Mffnet("s"), {"net": "mffnet", "size": "s"})
    method = Completion(model="mffnet", size="s", runtime="fp32", weights=path)
    sparse_m = np.where(np.random.default_rng(1).random(SIZE) < 0.08, road(), F(0))
    plain = complete(sparse_m, image(), Camera(CAMERA.K, SIZE), T_CAM_LIDAR)
    np.testing.assert_allclose(mended(method, sparse_m).depth_m, plain.depth_m, rtol=1e-5)


def test_flags_that_contradict() -> None:
    with pytest.raises(DataError, match="of a network"):
        Completion(weights=Path("a.safetensors"))


def test_weights_decide_the_key(method: Completion, tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    weights.write(path, network(seed=1), {"net": "mffnet", "size": "s"})
    assert Completion().weights_digest() is None
    assert replace(method, weights=path).weights_digest() != method.weights_digest()
    with pytest.raises(DataError, match="no such file"):
        replace(method, weights=tmp_path / "none.safetensors").weights_digest()
