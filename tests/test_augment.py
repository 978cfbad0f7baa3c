"""Photometric augmentation: what it draws, what it leaves as it is, and that nothing moves."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import augment as slow

from priors.adapt.augment import SINGLE_IMAGE, Augmentation, augment, augment_pair, draw, draw_pair, to_light
from priors.adapt.camera_response import CameraResponse, compress, falloff, scale
from priors.adapt.distributions import Distribution, Effect, LogNormal, LogUniform, Normal, Uniform
from priors.codecs import as_rgb
from priors.learn import sky_augment
from priors.learn.sky_labels import REST, SKY, SkySample
from priors.learn.stereo_augment import REAL, RENDERED, StereoAugmentation, photometric

QUIET = Augmentation()
SHARE = st.floats(0, 1)


def picture(seed: int = 0, size: tuple[int, int] = (48, 80), grey: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.integers(0, 256, (*size, 3), dtype=np.uint8), (0, 0), 1.5)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    return image[..., 0].copy() if grey else image


@given(seed=st.integers(0, 10**6), grey=st.booleans(), rows=st.integers(1, 40), columns=st.integers(1, 60))
@settings(max_examples=60, deadline=None)
def test_a_single_image_gets_the_same_numbers_as_ever(seed: int, grey: bool, rows: int, columns: int) -> None:
    """Networks that were adapted before stay what they are, bit for bit: same draws, same arithmetic."""
    image = picture(seed, (rows, columns), grey)
    ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
    np.testing.assert_array_equal(augment(image, ours), slow.single_image(as_rgb(image), theirs))
    assert ours.random() == theirs.random()


@pytest.mark.parametrize("grey", [False, True])
def test_what_is_left_out_changes_nothing_and_draws_nothing(grey: bool) -> None:
    image, rng = picture(grey=grey), np.random.default_rng(3)
    np.testing.assert_array_equal(augment(image, rng, QUIET), image)
    assert rng.random() == np.random.default_rng(3).random()


@given(
    light=SHARE, gain=st.floats(0.1, 4), gamma=st.floats(0.3, 3), level=st.floats(0.2, 3), contrast=st.floats(0.5, 2)
)
@settings(max_examples=100, deadline=None)
def test_the_tone_curve_by_hand(light: float, gain: float, gamma: float, level: float, contrast: float) -> None:
    camera = CameraResponse(light_gain=(gain,), gamma=gamma, level_gain=(level,), contrast=contrast)
    found = camera.tone(np.full((1, 1, 1), light, np.float32))
    assert float(found[0, 0, 0]) == pytest.approx(slow.tone(light, gain, gamma, level, contrast), abs=1e-4)


def test_gains_of_channels_by_hand() -> None:
    values = np.random.default_rng(0).random((3, 4, 3)).astype(np.float32)
    each = np.array([0.5, 1.0, 2.0], np.float32)
    np.testing.assert_array_equal(scale(values, (0.5, 1.0, 2.0)), values * each)
    np.testing.assert_array_equal(scale(values[..., :1], (0.5, 1.0, 2.0)), values[..., :1] * each)
    np.testing.assert_array_equal(scale(values, (0.5,)), values * np.float32(0.5))


def test_grey_weights_saturation_and_vignette_by_hand() -> None:
    light = np.array([[[0.2, 0.6, 0.4]]], np.float32)
    assert float(CameraResponse(grey_weights=(0.3, 1.5, 1.2)).mix(light)[0, 0, 0]) == pytest.approx(
        (0.3 * 0.2 + 1.5 * 0.6 + 1.2 * 0.4) / 3
    )
    luma = 0.299 * 0.2 + 0.587 * 0.6 + 0.114 * 0.4
    expected = [luma + 1.5 * (value - luma) for value in (0.2, 0.6, 0.4)]
    np.testing.assert_allclose(CameraResponse(saturation=1.5).mix(light)[0, 0], expected, rtol=1e-5)
    share = falloff((5, 7), 0.4)
    assert share[2, 3] == 1 and share[0, 0] == share[4, 6] == pytest.approx(0.6)


@pytest.mark.parametrize("grain_px", [0.0, 0.7])
@pytest.mark.parametrize("colour_noise", [False, True])
def test_noise_has_the_deviation_asked_for(grain_px: float, colour_noise: bool) -> None:
    camera = CameraResponse(noise=6 / 255, grain_px=grain_px, colour_noise=colour_noise)
    image = camera.shoot(np.full((200, 300, 3), 0.5, np.float32), np.random.default_rng(1)).astype(float)
    assert np.std(image) == pytest.approx(6.0, rel=0.2)
    assert np.array_equal(image[..., 0], image[..., 2]) != colour_noise


def test_light_beyond_white_is_lost_before_the_picture_gets_darker() -> None:
    camera = CameraResponse(light_gain=(3.0,), level_gain=(0.5,))
    image = camera.shoot(np.array([[[0.21], [0.9]]], np.float32), np.random.default_rng(0))
    np.testing.assert_array_equal(image, [[80, 128]])


def test_jpeg_keeps_the_shape_and_loses_detail() -> None:
    for image in (picture(), picture(grey=True)):
        poor, good = compress(image, 20), compress(image, 95)
        assert poor.shape == good.shape == image.shape
        off = [np.abs(one.astype(float) - image).mean() for one in (poor, good)]
        assert off[0] > off[1] > 0


@pytest.mark.parametrize("seed", range(8))
def test_nothing_moves(seed: int) -> None:
    pair, rng = (picture(1, (96, 192)), picture(2, (96, 192))), np.random.default_rng(seed)
    calm = replace(REAL.photometric.common, extreme=0.0, noise=None)
    left, right = augment_pair(*pair, rng, replace(REAL.photometric, common=calm))
    for before, after in zip(pair, (left, right), strict=True):
        grey = [cv2.cvtColor(a, cv2.COLOR_RGB2GRAY) if a.ndim == 3 else a for a in (before, after)]
        shift, _ = cv2.phaseCorrelate(*(a.astype(np.float64) for a in grey))
        assert np.hypot(*shift) < 0.15


def test_the_views_of_a_pair_are_alike_and_now_and_then_less_so() -> None:
    rng = np.random.default_rng(0)
    pairs = [draw_pair(rng, REAL.photometric, 3) for _ in range(600)]
    assert all((a.grey_weights is None) == (b.grey_weights is None) for a, b in pairs)
    assert all(a.saturation == b.saturation and a.quality == b.quality for a, b in pairs)
    gains = np.log([[np.mean(a.level_gain), np.mean(b.level_gain)] for a, b in pairs])
    apart = np.abs(gains[:, 0] - gains[:, 1])
    assert 0 < np.median(apart) < 0.1 < np.quantile(apart, 0.95) < np.std(gains) * 2
    one_sided = np.mean([(a.blur_px > 0) != (b.blur_px > 0) for a, b in pairs])
    assert one_sided == pytest.approx(0.5 * 2 * 0.25 * 0.75, abs=0.06)


def test_rendered_streets_get_more_contrast_and_darker_blacks() -> None:
    rng = np.random.default_rng(0)
    real, rendered = ([draw_pair(rng, one.photometric, 3)[0] for _ in range(500)] for one in (REAL, RENDERED))
    assert np.mean([c.contrast for c in rendered]) == pytest.approx(1.3 * np.mean([c.contrast for c in real]), rel=0.05)
    assert 255 * np.mean([c.black for c in rendered]) == pytest.approx(-4, abs=0.5)


@given(seed=st.integers(0, 10**6), low=st.floats(0.1, 5), factor=st.floats(1, 5))
@settings(max_examples=50, deadline=None)
def test_distributions_hold_what_they_say(seed: int, low: float, factor: float) -> None:
    rng = np.random.default_rng(seed)
    for bounded in (Uniform(low, factor * low), LogUniform(low, factor * low)):
        values = bounded.draw(rng, 50)
        assert values.shape == (50,) and values.min() >= low * (1 - 1e-9) and values.max() <= factor * low * (1 + 1e-9)
    assert LogNormal(low, factor).draw(rng, 50).min() > 0
    assert Effect(0, Uniform(low, low)).draw(rng) == 0 and Effect(1, Uniform(low, low)).draw(rng) == low


@pytest.mark.parametrize(
    ("distribution", "median"), [(Normal(3, 2), 3), (LogNormal(3, 0.5), 3), (LogUniform(1, 9), 3), (Uniform(1, 5), 3)]
)
def test_distributions_lie_around_their_middle(distribution: Distribution, median: float) -> None:
    assert np.median(distribution.draw(np.random.default_rng(0), 4001)) == pytest.approx(median, rel=0.06)


def test_ranges_check_themselves() -> None:
    wrong = [
        lambda: Uniform(2, 1),
        lambda: LogUniform(0, 1),
        lambda: Normal(0, -1),
        lambda: LogNormal(0, 1),
        lambda: Effect(1.5, Uniform(0, 1)),
        lambda: Augmentation(grey=2),
        lambda: Augmentation(grey_weights=(1, 1, 0)),
        lambda: replace(photometric(), differing=-1),
        lambda: StereoAugmentation(smallest_zoom=3),
        lambda: StereoAugmentation(covered=2),
    ]
    for make in wrong:
        with pytest.raises(ValueError, match="expected") as caught:
            make()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("grey", [False, True])
def test_sky_copies_keep_their_labels(grey: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_augment, "BARE", 0.0)
    image = picture(4, (120, 200), grey)
    label = np.where(np.arange(120)[:, None] < 50, SKY, REST) * np.ones((120, 200), np.float32)
    rng = np.random.default_rng(0)
    for _ in range(20):
        altered, (share, known) = sky_augment.draw_view(SkySample("here", image, label), (64, 96), rng)
        assert altered.shape == (64, 96, 3) and altered.dtype == np.uint8
        assert share.shape == (32, 48) and (known > 0.99).all()
        assert np.diff(share, axis=0).max() < 0.001  # sky above, whatever was cut or mirrored


def test_another_sky_changes_the_sky_only() -> None:
    light = to_light(picture(5, (60, 90)), 2.2)
    label = np.where(np.arange(60)[:, None] < 30, SKY, REST) * np.ones((60, 90), np.float32)
    changed = sky_augment.change_sky(light, label, np.random.default_rng(1))
    np.testing.assert_allclose(changed[32:], light[32:], rtol=1e-6)
    assert np.abs(changed[:28] - light[:28]).mean() > 0.01


def test_single_images_keep_three_channels_and_pairs_may_become_grey() -> None:
    rng = np.random.default_rng(0)
    assert all(augment(picture(grey=bool(n % 2)), rng).shape == (48, 80, 3) for n in range(20))
    shapes = {draw(rng, REAL.photometric.common, 3).shoot(to_light(picture()), rng).ndim for _ in range(30)}
    assert shapes == {2, 3} and SINGLE_IMAGE.tinted_grey
