"""Mono above KITTI's size: what the network looks at, what comes out, and which caches stay what they were."""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from test_mono import Road, file, intrinsics, net, road  # noqa: F401

from priors.methods._mono_network import APART, estimate
from priors.methods._mono_size import FOCAL_PX, LARGEST, LOOKS, PIXELS, looks, scaled, share_of
from priors.methods.mono import Mono
from priors.nets import bts
from priors.nets.runtime import Ready
from priors.records import record, upgrade
from priors.resized import Resized, thinned
from priors.types import Camera

pytestmark = pytest.mark.networks


@pytest.mark.parametrize("size", [(375, 1242), (376, 1241), (376, 1408), (64, 160), (1, 9000), (1, 1)])
def test_images_of_kittis_size_stay_as_they_are(size: tuple[int, int]) -> None:
    assert share_of(Camera(intrinsics(721.5, size), size)) == 1


@pytest.mark.parametrize(("size", "times"), [((375, 1242), 1), ((188, 621), 2), ((750, 2484), 0.5), ((64, 160), None)])
def test_two_looks_have_shares_of_kittis_size(size: tuple[int, int], times: float | None) -> None:
    found = looks(Camera(intrinsics(0.5 * size[1], size), size))
    assert found[1] / found[0] == pytest.approx(LOOKS[1] / LOOKS[0])
    assert found[0] == pytest.approx(LARGEST if times is None else LOOKS[0] * times, rel=5e-3)


def test_one_focal_length_for_both() -> None:
    assert bts.FOCAL_PX == FOCAL_PX


@pytest.mark.parametrize("size", [(900, 1600), (1200, 1920), (3000, 4000), (4000, 300), (5, 400_000)])
def test_larger_ones_get_as_many_pixels(size: tuple[int, int]) -> None:
    share = share_of(Camera(intrinsics(700, size), size))
    assert scaled(np.zeros(size, np.uint8), share).size == pytest.approx(PIXELS, rel=0.01 + 1 / min(size))


@pytest.mark.parametrize(("focal_px", "share"), [(300, 1), (1150, 1), (1443, 0.75), (2165, 0.5)])
def test_long_focal_lengths_are_shortened(focal_px: float, share: float) -> None:
    size = (375, 1242)
    assert share_of(Camera(intrinsics(focal_px, size), size)) == pytest.approx(share, rel=1e-3)


def test_a_picture_twice_as_large_is_of_the_same_scene(net: bts.Bts) -> None:  # noqa: F811
    cloudless = deepcopy(net)
    with torch.no_grad():  # of the last layer's maps the fourth is the sky
        cloudless.fine[1].weight[3], cloudless.fine[1].bias[3] = 0, -5
    view, ready = road(), Ready(cloudless, "fp32", {})
    image = np.repeat(np.repeat(view.image, 2, axis=0), 2, axis=1)
    K = view.camera.K.copy()
    K[:2] *= 2
    K[:2, 2] += 0.5  # pixel centres lie at integers
    one, other = estimate(ready, view.image, view.camera), estimate(ready, image, Camera(K, image.shape[:2]), (0.5,))
    assert other.values.shape == image.shape[:2] and other.log_error is not None and one.log_error is not None
    middle = other.values[::2, ::2], other.values[1::2, 1::2]
    known = (one.values > 0) & (middle[0] > 0) & (middle[1] > 0)
    assert known.mean() > 0.9
    ratio = np.stack(middle).mean(axis=0)[known] / one.values[known]
    assert np.median(np.abs(ratio - 1)) < 0.02
    np.testing.assert_allclose(np.median(other.log_error), np.median(one.log_error), rtol=0.05)


def test_two_looks_give_the_mean_of_their_logarithms(net: bts.Bts) -> None:  # noqa: F811
    view, ready = road(), Ready(net, "fp32", {})
    one, other = (estimate(ready, view.image, view.camera, (share,)) for share in (0.9, 0.6))
    both = estimate(ready, view.image, view.camera, (0.9, 0.6))
    assert one.log_error is not None and other.log_error is not None and both.log_error is not None
    known = (one.values > 0) & (other.values > 0) & (both.values > 0)
    assert known.any()
    np.testing.assert_allclose(both.values[known], np.sqrt(one.values * other.values)[known], rtol=1e-4)
    apart = np.abs(np.log(one.values[known] / other.values[known]))
    wanted = np.sqrt(one.log_error * other.log_error)[known] + APART * apart
    np.testing.assert_allclose(both.log_error[known], wanted, rtol=1e-3, atol=1e-5)


def test_what_adapts_looks_once_and_small_images_make_no_other_key(file: Path) -> None:  # noqa: F811
    mono, frame = Mono(weights=file, size="s", adapt="video"), Road(2)[0]
    small = record(mono.resolve(frame))
    assert small["resize"] == "none"
    assert upgrade(Mono, {name: value for name, value in small.items() if name != "resize"}) == small
    large = replace(frame, camera=Camera(intrinsics(1000, (900, 1600)), (900, 1600)))
    assert mono.resolve(large).resize == "auto"
    assert replace(mono, resize="none").resolve(large).resize == "none"
    assert replace(mono, adapt="none").resolve(frame).resize == "auto"


def test_a_large_frame_gets_a_map_of_its_size(file: Path) -> None:  # noqa: F811
    size = (700, 1400)
    frame = Road(1, size=size)[0]
    mono = Mono(weights=file, size="s", runtime="fp32").resolve(frame)
    depth, whole = mono(frame), replace(mono, resize="none")(frame)
    assert depth.depth_m.shape == size and np.isfinite(depth.depth_m).all() and depth.confidence is not None
    assert not np.array_equal(depth.depth_m, whole.depth_m)


def test_a_smaller_drive_has_smaller_cameras_and_sparse_maps() -> None:
    drive = Road(3)
    small, whole = Resized(drive, 0.5)[1], drive[1]
    assert small.image().shape == (32, 80, 3) and small.camera.size == (32, 80)
    assert small.camera.fx == pytest.approx(whole.camera.fx / 2)
    assert small.sparse().depth_m.shape == (32, 80)


@pytest.mark.parametrize("size", [(7, 5), (20, 31), (1, 1)])
def test_thinned_maps_keep_the_nearest(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    sparse_m = np.where(rng.random((20, 31)) < 0.2, rng.uniform(1, 50, (20, 31)), 0).astype(np.float32)
    want = np.zeros(size, np.float32)
    for row, column in zip(*np.nonzero(sparse_m), strict=True):
        at = int((row + 0.5) * size[0] / 20), int((column + 0.5) * size[1] / 31)
        if want[at] == 0 or sparse_m[row, column] < want[at]:
            want[at] = sparse_m[row, column]
    np.testing.assert_array_equal(thinned(sparse_m, size), want)
