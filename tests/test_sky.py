"""Sky mask: shapes and kinds of images, scenes with a known answer, real frames, and its kernels against numpy."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import sky
from priors.kernels import sky as kernels
from priors.learn.sky_labels import SKY, UNKNOWN, read_camvid
from priors.methods import _stereo_classical as classical
from priors.methods.completion import Completion
from priors.methods.stereo import Stereo
from priors.sky import sky_mask
from priors.types import Camera, Depth, Frame


def painted(size: tuple[int, int] = (375, 1242)) -> tuple[np.ndarray, np.ndarray]:
    """A road, house fronts, a pole and a sky that brightens towards the horizon; and the sky's mask."""
    height, width = size
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=size), (0, 0), 1)[..., None] * 120
    image = np.clip(np.array([70, 66, 60]) + noise, 0, 255)
    v, u = np.mgrid[0:height, 0:width] / np.array([height, width]).reshape(2, 1, 1)
    mask = v < 0.45 - 0.5 * np.abs(u - 0.5)
    pole = np.abs(u - 0.45) < 4 / width
    mask &= ~pole
    blue = np.array([150, 190, 240]) + (v * 60)[..., None]
    image = np.where(mask[..., None], np.minimum(blue, 255), np.where(pole[..., None], 40, image))
    return image.astype(np.uint8), mask


def street(size: tuple[int, int] = (188, 620)) -> tuple[Frame, np.ndarray]:
    """The painted street as a pair 8 px apart with samples on every third row, the sky's too; and the sky's mask."""
    image, mask = painted(size)
    K = np.array([[360.0, 0, 310], [0, 360, 94], [0, 0, 1]])
    sparse_m = np.zeros(size, np.float32)
    sparse_m[::3] = 20
    other = np.roll(image, -8, axis=1)
    read = {"image": lambda: image, "other": lambda: other, "sparse": lambda: Depth(sparse_m)}
    return Frame("0", Camera(K, size), read, {"sweep": "no LiDAR"}, baseline_m=0.54), mask


@pytest.mark.parametrize("method", [Stereo(), Completion(source="velodyne_raw")], ids=["stereo", "completion"])
def test_what_methods_say_of_the_sky_is_not_trusted(method: Stereo | Completion) -> None:
    frame, mask = street()
    depth = method(frame)
    assert depth.confidence is not None
    found = sky_mask(frame.image())
    assert iou(found, mask) > 0.95
    assert not depth.confidence[found].any()
    assert np.mean(depth.confidence[~mask] > 0) > 0.95


def test_rows_that_hold_sky_only_are_not_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    frame, _ = street()
    shapes: list[tuple[int, ...]] = []
    estimate = classical.estimate

    def watched(left: np.ndarray, right: np.ndarray, most_px: int, sky: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shapes.append(left.shape)
        return estimate(left, right, most_px, sky)

    monkeypatch.setattr(classical, "estimate", watched)
    mask = np.zeros((188, 620), bool)
    mask[:60], mask[70, :] = True, True
    monkeypatch.setattr("priors.methods.stereo.sky_mask", lambda image: mask)
    depth = Stereo()(frame)
    assert shapes == [(188 - 44, 620, 3)]
    assert not depth.depth_m[:44].any() and np.mean(depth.depth_m[44:] > 0) > 0.9
    assert sky.rows_below(np.ones((9, 4), bool)) == sky.rows_below(np.zeros((9, 4), bool)) == slice(0, 9)


def iou(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.sum(found & true) / np.sum(found | true))


def test_painted_sky_is_found_and_the_pole_before_it_is_not() -> None:
    image, mask = painted()
    found = sky_mask(image)
    assert iou(found, mask) > 0.95
    centre = round(0.45 * image.shape[1])
    assert np.mean(found[:140, centre - 2 : centre + 3]) < 0.1
    assert found[:140, centre - 30].all()


@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_exposure_and_resolution_do_not_matter_much(gain: float) -> None:
    image, mask = painted()
    assert iou(sky_mask((image * gain).astype(np.uint8)), mask) > 0.93
    small = cv2.resize(image, (397, 120), interpolation=cv2.INTER_AREA)
    assert iou(sky_mask(small), cv2.resize(mask.astype(np.uint8), (397, 120)) > 0) > 0.85


def test_grey_image_is_read_as_its_three_equal_channels() -> None:
    grey = cv2.cvtColor(painted()[0], cv2.COLOR_RGB2GRAY)
    np.testing.assert_array_equal(sky_mask(grey), sky_mask(np.repeat(grey[..., None], 3, axis=2)))


@pytest.mark.parametrize("level", [0, 30, 128])
def test_textured_ground_everywhere_is_no_sky(level: int) -> None:
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(200, 300, 3)), (0, 0), 2)
    assert np.mean(sky_mask(np.clip(level + 300 * noise, 0, 255).astype(np.uint8))) < 0.01


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 40), st.integers(0, 60), st.booleans(), st.integers(0, 255))
def test_any_size_gives_a_mask_of_that_size(height: int, width: int, grey: bool, level: int) -> None:
    image = np.full((height, width) if grey else (height, width, 3), level, np.uint8)
    found = sky_mask(image)
    assert found.shape == (height, width)
    assert found.dtype == np.bool_


def test_strided_images_are_read_as_they_look() -> None:
    image, _ = painted((120, 300))
    bgr = np.ascontiguousarray(image[..., ::-1])
    np.testing.assert_array_equal(sky_mask(bgr[..., ::-1]), sky_mask(image))


def test_the_given_image_is_not_written_to() -> None:
    image, _ = painted((120, 300))
    copy = image.copy()
    sky_mask(image)
    np.testing.assert_array_equal(image, copy)


def test_camvid_frames(real_data: Callable[..., Path]) -> None:
    both = either = 0
    for sample in list(read_camvid(real_data("camvid"), "val"))[::10]:
        known = sample.label != UNKNOWN
        found, true = sky_mask(sample.image) & known, sample.label == SKY
        both += np.count_nonzero(found & true)
        either += np.count_nonzero(found | true)
    assert both / either > 0.9


@given(st.integers(1, 5), st.integers(1, 13), st.integers(1, 13), st.integers(0, 99))
@settings(deadline=None)
def test_shrink_is_the_mean_of_blocks(factor: int, height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)
    colour = kernels.shrink(image, factor)
    for i, j in np.ndindex(colour.shape[:2]):
        block = slice(i * factor, (i + 1) * factor), slice(j * factor, (j + 1) * factor)
        np.testing.assert_allclose(colour[i, j], image[block].mean(axis=(0, 1)) / 255, atol=1e-6)
    assert colour.shape == (-(-height // factor), -(-width // factor), 3)


def test_guided_model_repeats_a_target_that_is_linear_in_colour() -> None:
    image = np.random.default_rng(0).integers(0, 256, (24, 30, 3)).astype(np.uint8)
    colour = kernels.shrink(image, 1)
    weights = np.array([0.5, -0.3, 0.4], np.float32)
    model = sky.guided_model(colour, colour @ weights + np.float32(0.2), smoothing=1e-7)
    np.testing.assert_allclose(model[..., :3], np.broadcast_to(weights, (24, 30, 3)), atol=1e-3)
    np.testing.assert_allclose(model[..., 3], 0.2, atol=1e-3)
    expected = (image / 255) @ weights.astype(float) + 0.2
    clear = np.abs(expected - 0.5) > 1e-3
    np.testing.assert_array_equal(kernels.apply_linear(image, model, 1)[clear], (expected > 0.5)[clear])


def test_what_has_the_colours_of_the_sky_around_is_sky_though_the_network_doubts_it() -> None:
    rng = np.random.default_rng(0)
    colour = rng.uniform(0.1, 0.3, (40, 60, 3)).astype(np.float32)
    colour[:20] = np.array([0.6, 0.7, 0.9], np.float32) + rng.normal(size=(20, 60, 3)).astype(np.float32) * 0.01
    target = np.zeros((40, 60), np.float32)
    target[:20] = 1
    target[6:14, 20:29] = 0.25
    model = sky.guided_model(colour, target)
    found = (model[..., :3] * colour).sum(axis=2) + model[..., 3] > 0.5
    np.testing.assert_array_equal(found[:20], True)
    np.testing.assert_array_equal(found[20:], False)


def test_model_is_interpolated_between_block_centres() -> None:
    model = np.zeros((1, 2, 4), np.float32)
    model[0, 1, 3] = 1  # 0 at the left block's centre, 1 at the right one's
    mask = kernels.apply_linear(np.zeros((4, 8, 3), np.uint8), model, 4)
    np.testing.assert_array_equal(mask, np.tile(np.arange(8) >= 4, (4, 1)))
