"""Recordings left out of the sky mask's fit: what is fitted on, and what is scored."""

import numpy as np
import pytest

from priors.errors import DataError
from priors.learn import fit_sky, sky_left_out
from priors.learn.sky_labels import REST, SKY, UNKNOWN, SkySample
from priors.sky import find_sky, load_weights, sky_mask

pytestmark = pytest.mark.networks


def sample(place: str, seed: int) -> SkySample:
    """A bright sky above a dark, rough ground."""
    rng = np.random.default_rng(seed)
    image = np.full((96, 160, 3), 225, np.uint8)
    image[40:] = rng.integers(20, 90, (56, 160, 3))
    label = np.where(np.arange(96)[:, None] < 40, SKY, REST) * np.ones((1, 160))
    label[38:42] = UNKNOWN
    return SkySample(place, image, label.astype(np.float32))


def test_the_rules_of_a_recording_never_saw_it(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = [sample(place, seed) for seed, place in enumerate(("0001", "0006", "0016", "06"))]
    seen: list[str] = []
    drawn = fit_sky.sample_blocks

    def watch(of: list[SkySample], seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
        seen.extend(one.place for one in of)
        return drawn(of, seed)

    monkeypatch.setattr(fit_sky, "sample_blocks", watch)
    monkeypatch.setattr(fit_sky, "COPIES", dict.fromkeys(fit_sky.COPIES, 4))
    found = []
    for recording, rules in sky_left_out.left_out(samples, 0):
        assert recording not in seen and len(set(seen)) == 3
        seen.clear()
        found.append(recording)
        assert sky_left_out.score([one for one in samples if one.place == recording], rules) > 0.9
    assert tuple(found) == sky_left_out.RECORDINGS


def test_the_score_is_over_known_pixels_of_all_frames() -> None:
    samples, rules = [sample("06", 1), sample("06", 2)], load_weights()
    both = either = 0
    for one in samples:
        known = one.label != UNKNOWN
        both += np.sum(find_sky(one.image, rules) & (one.label == SKY))
        either += np.sum((find_sky(one.image, rules) | (one.label == SKY)) & known)
    assert sky_left_out.score(samples, rules) == pytest.approx(both / either)
    np.testing.assert_array_equal(find_sky(samples[0].image, rules), sky_mask(samples[0].image))


def test_one_place_is_not_enough() -> None:
    with pytest.raises(DataError, match="two others are needed"):
        next(sky_left_out.left_out([sample("0001", 0)], 0))
