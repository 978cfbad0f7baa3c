"""The completion network: what it promises for any input, the method around it, and what it learns from."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from priors.errors import DataError
from priors.learn import scans
from priors.learn.accumulated import agrees
from priors.learn.completion import CompletionConfig, CompletionTask
from priors.learn.odometry import align
from priors.learn.sample import Sample, write
from priors.learn.scans import Scene
from priors.methods._completion_network import span
from priors.methods.completion import Completion, complete, near_samples
from priors.nets import runtime, weights
from priors.nets.fused import available, fuse
from priors.nets.mffnet import LARGEST_CHANGE, SIZES, Mffnet, _correct, correct, describe, exchange
from priors.types import Camera, Depth, FloatMap

F = np.float32
SIZE = (75, 140)
CAMERA = Camera(np.array([[100.0, 0, 70], [0, 100, 30], [0, 0, 1]]), SIZE)
T_CAM_LIDAR = np.array([[0, -1.0, 0, 0.06], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
torch.set_num_threads(1)


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
        ours, twin = _correct(raw, log_fill), correct(raw, log_fill, branches=False)
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
    if not available():
        pytest.skip("this torch has no fused operators")
    ready = runtime.make_ready(network(), "bf16" if kind == torch.bfloat16 else "fp32")
    given = inputs()
    before = ready(*given)
    after = runtime.Ready(fuse(ready.net), ready.runtime, {})(*given)
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
    return method.mend(sparse_m, picture, Camera(K, sparse_m.shape), T_CAM_LIDAR)


def check(depth: Depth, sparse_m: FloatMap, reach_px: int = 64) -> None:
    """What is promised for any input: finite, bounded by the samples, a value near samples and nowhere else."""
    assert depth.confidence is not None
    assert depth.depth_m.shape == depth.confidence.shape == sparse_m.shape
    assert np.isfinite(depth.depth_m).all() and np.isfinite(depth.confidence).all()
    assert np.array_equal(depth.valid, near_samples(sparse_m, reach_px))
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


# --- what it learns from


def scene(real: bool = False, seed: int = 0) -> Scene:
    """Scan lines on a road and a box that stands on it."""
    truth_m = road((288, 576))
    truth_m[60:160, 200:260] = 3.0
    rng = np.random.default_rng(seed)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(40, 288, 5), np.arange(1, 576, 3), indexing="ij"))
    z = truth_m[row, column]
    camera = Camera(np.array([[300.0, 0, 280], [0, 300, 90], [0, 0, 1]]), (288, 576))
    points = np.stack([(column - 280) * z / 300, (row - 90) * z / 300, z], axis=1).astype(F)
    picture = rng.integers(0, 255, (288, 576, 3)).astype(np.uint8)
    return Scene(picture, camera, T_CAM_LIDAR, points, ((row - 40) // 5).astype(np.uint8), truth_m, real)


def test_points_fall_where_the_truth_is() -> None:
    sparse_m = scans.splat(scene().points_m, scene().camera)
    assert (sparse_m > 0).sum() == len(scene().points_m)
    np.testing.assert_allclose(sparse_m[sparse_m > 0], scene().truth_m[sparse_m > 0], rtol=1e-5)


def test_the_nearer_point_of_two_stays() -> None:
    points = np.array([[0, 0, 9.0], [0, 0, 4.0], [0, 0, 20.0]], F)
    assert scans.splat(points, CAMERA)[30, 70] == 4


@pytest.mark.parametrize("change", ["crop", "flip", "both"])
def test_changed_scenes_still_agree_with_their_truth(change: str) -> None:
    changed = scene()
    if change != "flip":
        changed = scans.crop(changed, 20, 50, (256, 512))
    if change != "crop":
        changed = scans.flip(changed)
    sparse_m = scans.splat(changed.points_m, changed.camera)
    assert changed.image.shape == (*changed.camera.size, 3) and (sparse_m > 0).sum() > 5000
    np.testing.assert_allclose(sparse_m[sparse_m > 0], changed.truth_m[sparse_m > 0], rtol=1e-5)


def test_rescaled_scenes_look_the_same() -> None:
    near = scans.rescale(scene(), 0.5)
    far = scans.splat(scene().points_m, scene().camera)
    np.testing.assert_allclose(scans.splat(near.points_m, near.camera), 0.5 * far, rtol=1e-5)
    np.testing.assert_allclose(near.truth_m, 0.5 * scene().truth_m)


@pytest.mark.parametrize("every", [1, 2, 8])
def test_lines_are_left_out(every: int) -> None:
    shown = scans.show(scene(), np.random.default_rng(0), every)
    rows = np.unique(np.nonzero(shown.sparse_m)[0])
    assert np.array_equal(rows, np.arange(40, 288, 5)[::every])
    assert shown.weight[100, 300] == 1 and shown.weight[10, 300] < 0.1
    assert 0 < shown.weight[100, 200] < 1  # at the box's outline


def test_real_truth_is_what_was_not_shown_and_what_others_saw() -> None:
    unseen = replace(scene(real=True), truth_m=np.zeros((288, 576), F))
    shown = scans.show(unseen, np.random.default_rng(0), every=2)
    known = shown.weight > 0
    assert known.any() and not (known & (shown.sparse_m > 0)).any()
    np.testing.assert_allclose(shown.truth_m[known], scene().truth_m[known], rtol=1e-5)


def test_values_that_the_own_sweep_denies() -> None:
    own_m = np.zeros((60, 60), F)
    own_m[::4, ::4] = 10
    own_m[::4, 32::4] = 20
    seen_m = np.full((60, 60), 15, F)
    kept = agrees(seen_m, own_m)
    assert kept[30, 30] and not kept[30, 5] and not kept[30, 55]
    assert not agrees(seen_m, np.zeros((60, 60), F)).any()


def test_a_sweep_finds_where_it_stands() -> None:
    rng = np.random.default_rng(0)
    floor = np.stack([rng.uniform(0, 20, 3000), rng.uniform(-8, 8, 3000), np.full(3000, -1.7)], axis=1)
    wall = np.stack([rng.uniform(0, 20, 2000), np.full(2000, 6.0), rng.uniform(-1.7, 4, 2000)], axis=1)
    front = np.stack([np.full(1500, 19.0), rng.uniform(-8, 6, 1500), rng.uniform(-1.7, 4, 1500)], axis=1)
    fixed = np.concatenate([floor, wall, front])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.004, -0.006, 0.02]).as_matrix()
    T[:3, 3] = 0.4, -0.1, 0.03
    moving = (fixed[rng.random(len(fixed)) < 0.8] - T[:3, 3]) @ T[:3, :3]
    found = align(moving, fixed, np.eye(4))
    np.testing.assert_allclose(found, T, atol=2e-3)


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """Two samples to train on and one to validate on."""
    for number in (0, 1, 72):
        one = scene(seed=number)
        disparity_px = (300 * 0.54 / one.truth_m).astype(F)
        sky = np.zeros((288, 576), bool)
        found = Sample(one.image, one.image, disparity_px, sky, one.camera, 0.54, one.points_m, one.beam)
        write(tmp_path / "street" / f"{number:06d}.npz", found)
    return tmp_path / "street"


def test_the_task_is_decided_by_its_arguments_and_learns(street: Path) -> None:
    task = CompletionTask(CompletionConfig(street, batch=2, size="s"))
    assert len(task.streets.train) == 2 and len(task.streets.validation) == 1
    first, again = (task.batch(3, np.random.default_rng([0, 3])) for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert first["image"].shape == (2, 3, 192, 448) and all(torch.isfinite(value).all() for value in first.values())
    first["truth_m"] *= 1.2  # the pre-fill is wrong everywhere, and the network can tell by how much
    optimiser = torch.optim.Adam(task.net.parameters(), 3e-3)
    losses = []
    for _ in range(5):
        loss, _ = task.loss(first)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.9 * losses[0]


def test_validation_of_an_untrained_network_is_the_pre_fill(street: Path) -> None:
    task = CompletionTask(CompletionConfig(street, size="s"))
    with torch.inference_mode():
        found = task.validate(task.net.eval())
        pictures = task.pictures(task.net)
    assert found["error"] == pytest.approx(1, rel=1e-3)
    assert found["street_mae"] == pytest.approx(found["street_mae_fill"], rel=1e-3) and found["street_mae"] > 0
    assert pictures["street"].shape == (3 * 288, 2 * 576, 3)


def test_a_folder_without_samples(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no samples to train on"):
        CompletionTask(CompletionConfig(tmp_path))
