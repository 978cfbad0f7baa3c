"""PSNR and SSIM: equal to the loops and to the libraries whose definitions they are; extremes have stated answers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import image as slow
from skimage.metrics import peak_signal_noise_ratio

from eval.image import ImageScore, as_uint8, mean, mse, psnr, ssim_gauss11, ssim_uniform7
from eval.protocol import ScoreError

pytestmark = pytest.mark.filterwarnings("error")


def pair(seed=0, size=(14, 17), noise=0.1):
    """A smooth random image and a noisy copy, float in [0, 1]."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]]
    truth = 0.5 + 0.4 * np.sin(rows[..., None] / 3 + columns[..., None] / (2 + random.random(3)))
    return np.clip(truth + noise * random.standard_normal(truth.shape), 0, 1), truth


@pytest.mark.parametrize("seed", range(3))
def test_figures_equal_the_loops(seed):
    image, truth = pair(seed)
    saved = as_uint8(image), as_uint8(truth)
    found = ImageScore.over(image, truth).figures()
    uniform = np.full((7, 7), 1 / 49)
    assert found["psnr"] == pytest.approx(slow.psnr(image, truth, 1.0), abs=1e-10)
    assert found["psnr_uint8"] == pytest.approx(slow.psnr(saved[0] * 1.0, saved[1] * 1.0, 255.0), abs=1e-10)
    assert found["ssim_uniform7"] == pytest.approx(slow.ssim(*saved, uniform, 255, 49 / 48), abs=1e-10)
    assert found["ssim_gauss11"] == pytest.approx(slow.ssim(image, truth, slow.gauss_window(), 1, 1), abs=1e-10)
    assert abs(found["ssim_uniform7"] - found["ssim_gauss11"]) > 1e-3  # two figures, not one by two names


@pytest.mark.parametrize("size", [(11, 11), (40, 67), (120, 397)])
def test_figures_equal_scikit_image_s_own_psnr(size):
    image, truth = pair(1, size)
    saved = as_uint8(image), as_uint8(truth)
    assert psnr(mse(*saved), 255) == pytest.approx(peak_signal_noise_ratio(saved[1], saved[0]), abs=1e-10)
    assert psnr(mse(image, truth)) == pytest.approx(peak_signal_noise_ratio(truth, image, data_range=1), abs=1e-10)


def test_grey_images_score_as_colour_ones_with_three_equal_channels():
    image, truth = (each[..., 0] for each in pair(2))
    grey = ImageScore.over(image, truth).figures()
    colour = ImageScore.over(*(np.repeat(each[..., None], 3, axis=2) for each in (image, truth))).figures()
    assert grey == pytest.approx(colour, abs=1e-12)


def test_known_values():
    black, grey = np.zeros((16, 16, 3)), np.full((16, 16, 3), 0.1)
    found = ImageScore.over(grey, black).figures()
    assert found["psnr"] == pytest.approx(20.0)
    assert found["psnr_uint8"] == pytest.approx(10 * math.log10(255**2 / 26**2))  # 25.5 is saved as 26: ties to even
    # Flat images have no variance: what is left is the term of the means.
    assert found["ssim_gauss11"] == pytest.approx(1e-4 / (0.01 + 1e-4))


def test_equal_images_are_perfect_and_infinite_in_the_mean():
    image, truth = pair()
    same = ImageScore.over(truth, truth)
    assert same.figures() == {
        "psnr": math.inf, "psnr_uint8": math.inf, "ssim_uniform7": 1.0, "ssim_gauss11": 1.0
    }  # fmt: skip
    assert mean([same, ImageScore.over(image, truth)])["psnr"] == math.inf


def test_a_mean_is_of_the_images_figures():
    scores = [ImageScore.over(*pair(seed, noise=0.02 * (seed + 1))) for seed in range(3)]
    assert mean(scores)["psnr"] == pytest.approx(np.mean([score.figures()["psnr"] for score in scores]))
    assert mean(scores)["psnr"] != pytest.approx(psnr(float(np.mean([score.mse for score in scores]))), abs=0.1)
    assert all(math.isnan(value) for value in mean([]).values())


def test_lpips_is_averaged_only_where_all_have_it():
    with_it = ImageScore(0.1, 1.0, 0.5, 0.5, {"vgg": 0.2})
    assert mean([with_it, with_it])["lpips_vgg"] == pytest.approx(0.2)
    assert "lpips_vgg" not in mean([with_it, ImageScore(0.1, 1.0, 0.5, 0.5)])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 1))
def test_ssim_is_symmetric_and_at_most_1(seed, low, spread):
    random = np.random.default_rng(seed)
    a, b = np.clip(low + spread * random.random((2, 12, 13, 3)), 0, 1)
    for one, other, measure in ((a, b, ssim_gauss11), (as_uint8(a), as_uint8(b), ssim_uniform7)):
        assert measure(one, other) == pytest.approx(measure(other, one), abs=1e-12)
        assert -1 <= measure(one, other) <= 1 + 1e-9


def test_floats_are_clipped_and_rounded_as_they_are_saved():
    wild = np.full((11, 11, 3), 7.0)
    assert ImageScore.over(wild, np.ones((11, 11, 3))).mse == 0
    assert ImageScore.over(np.full((11, 11, 3), 0.5019), np.full((11, 11, 3), 128, np.uint8)).mse_uint8 == 0


def test_bad_images_are_refused():
    image, truth = pair()
    with pytest.raises(ScoreError, match="image is 14x17x3, truth 14x16x3: they must be one size"):
        ImageScore.over(image, truth[:, :-1])
    with pytest.raises(ScoreError, match="image is 10x17: SSIM needs 11 px each way"):
        ImageScore.over(image[:10], truth[:10])
    for bad in (np.nan, np.inf):
        image[3, 4, 1] = bad
        with pytest.raises(ScoreError, match="1 values that are not finite"):
            ImageScore.over(image, truth)
