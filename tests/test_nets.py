"""The networks' parts against their slow obvious twins, and what any stereo network must hold to."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from priors.nets import cost_volume, matching
from priors.nets.blocks import Exact, Residual, UpsampleConv, both, channels_last, conv, conv3d, fold
from priors.nets.cfnet import Cfnet, SearchRange
from priors.nets.fused import FusedExact, available, fuse, spread_over_planes
from priors.nets.pcwnet import Pcwnet
from priors.nets.stereo_input import preprocess
from priors.nets.stereo_output import StereoOut
from priors.nets.tensors import join
from priors.nets.trunk import Trunk, pad
from priors.nets.upsample import convex

NETWORKS = [Cfnet, Pcwnet]


def naive_lookup(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    batch, height, width, channels = left.shape
    planes, size = disparity_px.shape[3], channels // groups
    out = torch.zeros(batch, groups, height, width, planes)
    for b, y, x, p in np.ndindex(batch, height, width, planes):
        column = x - float(disparity_px[b, y, x, p])
        if not 0 <= column <= width - 1:
            continue
        x0 = min(int(np.floor(column)), width - 2)
        there = right[b, y, x0] + (column - x0) * (right[b, y, x0 + 1] - right[b, y, x0])
        for g in range(groups):
            part = slice(g * size, (g + 1) * size)
            out[b, g, y, x, p] = (left[b, y, x, part] * there[part]).sum()
    return out


def random_pair(seed: int, width: int = 9) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    left, right = (torch.randn(2, 3, width, 8, generator=generator) for _ in range(2))
    return left, right, torch.rand(2, 3, width, 4, generator=generator) * (width + 2) - 1


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), width=st.integers(2, 11))
def test_matching_equals_the_naive_loops(seed: int, width: int) -> None:
    pair = random_pair(seed, width)
    expected = naive_lookup(*pair, 2)
    torch.testing.assert_close(cost_volume.lookup(*pair, 2), expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(matching.lookup_units(*pair, 2), expected, atol=1e-5, rtol=1e-5)


def test_the_kernels_gradients_equal_those_of_plain_torch() -> None:
    pair = [t.requires_grad_() for t in random_pair(3)]
    ours, twin = matching.lookup_units(*pair, 2), cost_volume.lookup(*pair, 2)
    push = torch.randn(ours.shape, generator=torch.Generator().manual_seed(1))
    for a, b in zip(torch.autograd.grad(ours, pair, push), torch.autograd.grad(twin, pair, push), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-5)


def features(seed: int, width: int = 9) -> tuple[Tensor, Tensor, Tensor]:
    """Features (b, c, h, w) as a head leaves them, and disparities."""
    left, right, disparity_px = random_pair(seed, width)
    return 3 * left.permute(0, 3, 1, 2), 3 * right.permute(0, 3, 1, 2), disparity_px


def naive_volume(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    return naive_lookup(cost_volume.unit(left, groups), cost_volume.unit(right, groups), disparity_px, groups)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), width=st.integers(2, 90), groups=st.sampled_from([1, 2, 4, 8]))
def test_volumes_equal_the_naive_loops(seed: int, width: int, groups: int) -> None:
    left, right, disparity_px = features(seed, width)
    expected = naive_volume(left, right, disparity_px, groups)
    for grad in (torch.no_grad(), torch.enable_grad()):
        with grad:
            found = matching.lookup(left, right, disparity_px, groups, also=disparity_px)
            torch.testing.assert_close(found[:, :groups], expected, atol=1e-5, rtol=1e-5)
            torch.testing.assert_close(found[:, groups], disparity_px)
            torch.testing.assert_close(matching.lookup(left, right, disparity_px, groups), found[:, :groups])


def test_disparities_that_are_no_numbers_read_nothing_else() -> None:
    left, right, disparity_px = features(3)
    disparity_px[0, 0] = torch.nan
    with torch.no_grad():
        found = matching.lookup(left, right, disparity_px, 2)
    torch.testing.assert_close(found[1], naive_volume(left, right, disparity_px.nan_to_num(-1), 2)[1])


def test_bf16_features_are_multiplied_in_float32() -> None:
    left, right, disparity_px = features(2)
    left, right = left.to(torch.bfloat16), right.to(torch.bfloat16)
    expected = naive_volume(left.float(), right.float(), disparity_px, 2)
    with torch.no_grad():
        found = matching.lookup(left, right, disparity_px, 2)
    assert found.dtype == torch.bfloat16
    torch.testing.assert_close(found, expected.to(torch.bfloat16), atol=0, rtol=2**-8)


def test_a_full_range_is_a_lookup_at_whole_disparities() -> None:
    left, right, _ = features(5)
    expected = naive_volume(left, right, torch.arange(4.0).expand(2, 3, 9, 4), 2)
    with torch.no_grad():
        found = matching.correlate(left, right, 2, 4)
    twin = cost_volume.correlate(cost_volume.unit(left, 2), cost_volume.unit(right, 2), 2, 4)
    for volume_ in (found, matching.correlate(left, right, 2, 4), twin):
        torch.testing.assert_close(volume_, expected, atol=1e-5, rtol=1e-5)


def test_matches_stand_between_other_maps() -> None:
    left, right, disparity_px = features(8)
    before, after = [torch.rand(2, 3, 9, 2), torch.rand(2, 3, 9, 1)], [torch.rand(2, 3, 9, 3), torch.rand(2, 3, 9, 1)]
    matches = naive_volume(left, right, disparity_px, 2).permute(0, 2, 3, 1, 4).flatten(3)
    expected = torch.cat([*before, matches, *after], dim=3).permute(0, 3, 1, 2)
    for grad in (torch.no_grad(), torch.enable_grad()):
        with grad:
            found = matching.lookup_beside(before, left, right, disparity_px, 2, after)
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
        assert found.is_contiguous(memory_format=torch.channels_last)


def test_concatenation_puts_matching_columns_side_by_side() -> None:
    left, right = torch.rand(1, 2, 2, 6), torch.rand(1, 3, 2, 6)[:, :2]
    both = cost_volume.concatenate(left, right, 3)
    assert both.shape == (1, 4, 2, 6, 3)
    for x, d in np.ndindex(6, 3):
        assert torch.equal(both[0, :2, :, x, d], left[0, :, :, x])
        assert torch.equal(both[0, 2:, :, x, d], right[0, :, :, x - d] if x >= d else torch.zeros(2, 2))


def test_joined_maps_of_half_the_size_are_repeated() -> None:
    whole, half = torch.rand(2, 3, 6, 8), torch.rand(2, 5, 3, 4)
    found = join(whole, half)
    assert torch.equal(found[:, :3], whole)
    for y, x in np.ndindex(6, 8):
        assert torch.equal(found[:, 3:, y, x], half[:, :, y // 2, x // 2])


def test_a_shift_by_a_constant_moves_columns() -> None:
    right = torch.rand(1, 2, 7, 3)
    moved = cost_volume.shift(right, torch.full((1, 2, 7), 2.0))
    torch.testing.assert_close(moved[:, :, 2:], right[:, :, :-2])
    assert not moved[:, :, :2].any()


def test_unit_features_have_groups_of_length_one() -> None:
    features = cost_volume.unit(torch.randn(1, 8, 2, 3) * 100, 2)
    torch.testing.assert_close(features.reshape(1, 2, 3, 2, 4).norm(dim=-1), torch.ones(1, 2, 3, 2))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), planes=st.integers(1, 40), window=st.sampled_from([None, 0, 2]), own=st.booleans())
def test_the_kernels_of_distributions_equal_plain_torch(seed: int, planes: int, window: int | None, own: bool) -> None:
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(1, 5, 300, planes, generator=generator) * 20  # more pixels than a stretch holds
    positions = torch.rand(1, 5, 300, planes, generator=generator) if own else torch.arange(float(planes))
    features = torch.randn(2, 8, 3, 4, generator=generator) * 10
    features[0, :4, 0, 0] = 0  # a group without length
    with torch.no_grad():
        ours, length_one = matching.expect(logits, positions, window), matching.unit(features, 2)
    for found, expected in zip(ours, cost_volume.expect(logits, positions, window), strict=True):
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(length_one, cost_volume.unit(features, 2))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from([torch.float32, torch.bfloat16]), height=st.integers(1, 70))
def test_bytes_go_in_as_floats_do(seed: int, kind: torch.dtype, height: int) -> None:
    left, right = torch.randint(0, 256, (2, 1, 3, height, 45), generator=torch.Generator().manual_seed(seed))
    expected = preprocess(left.float() / 255, right.float() / 255, kind)
    with torch.no_grad():
        found = preprocess(left.byte(), right.byte(), kind)
    for ours, theirs, twin in zip(found, expected, preprocess(left.byte(), right.byte(), kind), strict=True):
        assert ours.dtype == kind
        torch.testing.assert_close(ours, theirs, atol=1e-6, rtol=0 if kind == torch.float32 else 2**-7)
        assert torch.equal(twin, theirs)


@pytest.mark.parametrize("planes", [1, 2, 7])
def test_a_3d_convolution_to_one_channel_is_a_2d_one(planes: int) -> None:
    torch.manual_seed(0)
    conv, x = nn.Conv3d(6, 1, 3, padding=1), torch.randn(2, 6, 5, 4, planes)
    flat = spread_over_planes(conv, planes)(x.permute(0, 4, 1, 2, 3).flatten(1, 2))
    torch.testing.assert_close(flat.permute(0, 2, 3, 1)[:, None], conv(x), atol=1e-5, rtol=1e-5)


@pytest.mark.skipif(not available(), reason="this torch build has no fused convolutions")
@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])
def test_a_fused_climb_equals_repeating_and_convolving(kind: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    climb = fold(UpsampleConv(*conv3d(8, 5)).eval()).requires_grad_(False).to(kind)
    nn.init.normal_(climb[0].bias, generator=generator)
    small, plus = torch.randn(2, 8, 3, 4, 2, generator=generator), torch.randn(2, 5, 6, 8, 4, generator=generator)
    small, plus = (v.to(kind).contiguous(memory_format=torch.channels_last_3d) for v in (small, plus))
    fused = fuse(channels_last(nn.ModuleList([climb])))
    found, expected = fused[0](small, plus), climb.float()(small.float(), plus.float())
    limit = 1e-5 if kind == torch.float32 else 0.03
    torch.testing.assert_close(found.float(), expected, atol=limit, rtol=limit)
    assert fuse(fused)[0] is fused[0]  # once is enough


@pytest.mark.skipif(not available(), reason="this torch build has no fused convolutions")
def test_a_fused_head_in_float32_needs_no_second_pass() -> None:
    head = fold(Exact(conv3d(8, 8), nn.Conv3d(8, 1, 3, padding=1)).eval()).requires_grad_(False)
    volume_ = torch.randn(1, 8, 5, 6, 4).contiguous(memory_format=torch.channels_last_3d)
    expected = head(volume_)
    fused = fuse(channels_last(nn.ModuleList([head])))[0]
    assert isinstance(fused, FusedExact)
    torch.testing.assert_close(fused(volume_), expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])
def test_two_heads_in_one_pass_are_two_heads(kind: torch.dtype) -> None:
    x = torch.randn(2, 8, 5, 6).to(kind).contiguous(memory_format=torch.channels_last)
    first, second = (nn.Conv2d(8, n, 3, padding=1).to(kind) for n in (6, 1))
    for found, expected in zip(both(x, first, second), (first(x), second(x)), strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5 if kind == torch.float32 else 0.02, rtol=1e-2)


@pytest.mark.skipif(not available(torch.bfloat16), reason="no fused convolutions in bf16 here")
@pytest.mark.parametrize("after", [nn.ReLU(), nn.LeakyReLU(0.3)], ids=["relu", "leaky"])
def test_a_fused_head_is_as_exact_as_float32(after: nn.Module) -> None:
    torch.manual_seed(0)
    first = conv3d(16, 16)
    first[-1] = after
    head = Exact(first, nn.Conv3d(16, 1, 3, padding=1)).eval()
    volume_ = torch.randn(1, 16, 6, 20, 8).to(torch.bfloat16, memory_format=torch.channels_last_3d)
    with torch.inference_mode():
        fold(head).to(torch.bfloat16)
        last, between = head[1], nn.Sequential(*head[0])
        fused = fuse(nn.ModuleList([head]))[0]
        features = fused.first(volume_)
        torch.testing.assert_close(features, between(volume_), atol=0.01, rtol=0.01)
        expected = nn.functional.conv3d(features.float(), last.weight.float(), last.bias.float(), padding=1)
        found, rounded = fused(volume_), last(features)
    assert found.dtype == torch.float32
    error = (found - expected).abs().max()
    assert error < 0.02 * (rounded.float() - expected).abs().max(), error


def test_mean_and_deviation_of_a_distribution() -> None:
    logits = torch.log(torch.tensor([[[[0.1, 0.2, 0.7]]]]))
    mean, sigma = cost_volume.expect(logits, torch.tensor([4.0, 6.0, 8.0]))
    assert mean.item() == pytest.approx(7.2)
    assert sigma.item() == pytest.approx(np.sqrt(0.1 * 3.2**2 + 0.2 * 1.2**2 + 0.7 * 0.8**2), rel=1e-4)


def test_a_windowed_mean_takes_one_of_two_surfaces_and_sigma_tells_of_both() -> None:
    logits = torch.full((1, 1, 1, 24), -20.0)
    logits[..., 3], logits[..., 20] = 1.0, 1.2
    mean, sigma = cost_volume.expect(logits, torch.arange(24.0), window=2)
    assert mean.item() == pytest.approx(20, abs=1e-3)
    assert sigma.item() > 8


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), factor=st.sampled_from([2, 4]))
def test_convex_upsampling_stays_between_its_neighbours(seed: int, factor: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(1, 2, 3, 4, generator=generator)
    weights = torch.randn(1, 9 * factor**2, 3, 4, generator=generator) * 50
    fine = convex(values, weights, factor)
    padded = nn.functional.pad(values, (1, 1, 1, 1), mode="replicate")
    for y, x in np.ndindex(3 * factor, 4 * factor):
        around = padded[0, :, y // factor : y // factor + 3, x // factor : x // factor + 3].flatten(1)
        assert (fine[0, :, y, x] <= around.amax(1) + 1e-5).all()
        assert (fine[0, :, y, x] >= around.amin(1) - 1e-5).all()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), factor=st.sampled_from([2, 4]), height=st.integers(1, 4))
def test_convex_upsamplings_kernel_equals_plain_torch(seed: int, factor: int, height: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(2, 3, height, 5, generator=generator)
    weights = torch.randn(2, 9 * factor**2, height, 5, generator=generator) * 20
    with torch.no_grad():
        ours = convex(values, weights, factor)
    torch.testing.assert_close(ours, convex(values, weights, factor), atol=1e-5, rtol=1e-5)


def test_convex_upsampling_with_all_weight_on_a_neighbour_repeats_it() -> None:
    values = torch.rand(1, 1, 3, 3)
    weights = torch.zeros(1, 4, 9, 3, 3)
    weights[:, :, 4] = 60.0  # the middle one
    fine = convex(values, weights.flatten(1, 2), 2)
    torch.testing.assert_close(fine, values.repeat_interleave(2, 2).repeat_interleave(2, 3))


def test_folding_changes_nothing() -> None:
    torch.manual_seed(0)
    net = nn.Sequential(conv(3, 8), Residual(8), conv(8, 4, stride=2))
    for _ in range(3):
        net(torch.rand(2, 3, 16, 16))  # moves the running statistics
    net.eval()
    image = torch.rand(1, 3, 16, 16)
    before = net(image)
    assert not any(isinstance(m, nn.BatchNorm2d) for m in fold(net).modules())
    torch.testing.assert_close(channels_last(net)(image), before, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("network", NETWORKS)
def test_fusing_changes_nothing_but_rounding(network: type[nn.Module]) -> None:
    torch.manual_seed(0)
    net = channels_last(fold(network("s").eval()))
    pair = torch.rand(2, 1, 3, 64, 96)
    with torch.inference_mode():
        before = net(*pair, 64)
        fused = fuse(net)
        assert not any(isinstance(m, Residual) for m in fused.modules()) or not available()
        after = fused(*pair, 64)
    torch.testing.assert_close(after.disparity_px, before.disparity_px, atol=2e-3, rtol=1e-3)


def test_the_trunk_gives_four_scales() -> None:
    levels = Trunk((8, 16, 24, 32))(torch.rand(1, 3, 64, 96))
    assert [tuple(level.shape[1:]) for level in levels] == [(8, 16, 24), (16, 8, 12), (24, 4, 6), (32, 2, 3)]


def test_padding_repeats_the_edges() -> None:
    image = torch.rand(1, 3, 33, 31)
    padded = pad(image)
    assert padded.shape == (1, 3, 64, 32)
    assert torch.equal(padded[:, :, :33, :31], image)
    assert torch.equal(padded[:, :, 63, 31], image[:, :, 32, 30])


def test_a_range_covers_the_uncertainty_and_learns_its_width() -> None:
    range_ = SearchRange(8, 2.5)
    disparity, sigma = torch.full((1, 1, 2), 20.0), torch.tensor([[[0.1, 6.0]]])
    position = range_(disparity, sigma)
    assert position[0, 0, 0, [0, -1]].tolist() == [17.5, 22.5]  # never narrower
    assert position[0, 0, 1, [0, -1]].tolist() == [14.0, 26.0]
    assert range_(torch.ones(1, 1, 1), torch.ones(1, 1, 1)).min() >= 0
    position[..., 0].sum().backward()
    assert range_.gamma.grad is not None and range_.gamma.grad.abs() > 0


@pytest.mark.parametrize("network", NETWORKS)
def test_every_parameter_of_a_stereo_network_learns(network: type[nn.Module]) -> None:
    from priors.learn.stereo import StereoTask

    torch.manual_seed(0)
    net = network("s")
    pair = torch.rand(2, 1, 3, 64, 96)
    truth = torch.rand(1, 64, 96) * 30
    batch = {"left": pair[0], "right": pair[1], "disparity_px": truth}
    batch["sky"] = torch.zeros(1, 64, 96)
    task = StereoTask(net, lambda rng: {})
    loss, _ = task.loss({**batch, "weight": torch.ones(1, 64, 96)})
    loss.backward()
    assert [name for name, p in net.named_parameters() if p.grad is None] == []


def test_the_sky_counts_little_against_what_stands_before_it() -> None:
    from priors.learn.stereo import SKY_WEIGHT, StereoTask

    class Constant(nn.Module):
        def forward(self, left: Tensor, right: Tensor, largest_px: int, stages: int) -> StereoOut:
            maps = torch.full_like(left[:, 0], 10.0)
            return StereoOut(maps, maps, torch.zeros_like(maps), [])

    image, sky = torch.zeros(1, 3, 4, 4), torch.zeros(1, 4, 4)
    sky[:, :2] = 1
    truth = torch.where(sky > 0, 0.0, 13.0)  # 10 px off in the sky, 3 px off below
    batch = {"left": image, "right": image, "disparity_px": truth, "sky": sky}
    _, terms = StereoTask(Constant(), lambda rng: {}).loss({**batch, "weight": torch.ones(1, 4, 4)})
    assert float(terms["epe"]) == pytest.approx((10 * SKY_WEIGHT + 3) / (SKY_WEIGHT + 1))


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("size", [(1, 50), (37, 1), (64, 96), (45, 70)])
def test_a_stereo_network_takes_any_size(network: type[nn.Module], size: tuple[int, int]) -> None:
    torch.manual_seed(0)
    net = network("s").eval()
    with torch.inference_mode():
        out = net(torch.rand(1, 3, *size), torch.rand(1, 3, *size), 64)
    for values in (out.disparity_px, out.sigma_px, out.doubt):
        assert values.shape == (1, *size) and values.dtype == torch.float32 and values.isfinite().all()
    assert out.disparity_px.min() >= 0 and out.stages == []


@pytest.mark.parametrize("network", NETWORKS)
def test_the_fused_kernel_and_plain_torch_give_the_same_disparity(
    network: type[nn.Module], monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    net = network("s").eval()
    pair = torch.rand(2, 1, 3, 64, 128)
    with torch.inference_mode():
        ours = net(*pair, 64).disparity_px
        for module in ("matching", "upsample"):
            monkeypatch.setattr(f"priors.nets.{module}.without_gradient", lambda tensor: False)
        monkeypatch.setattr("priors.nets.matching.on_cpu", lambda tensor: False)
        torch.testing.assert_close(net(*pair, 64).disparity_px, ours, atol=1e-3, rtol=1e-4)
