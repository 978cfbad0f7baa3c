"""Recalibration: the map of probabilities, its fit, the file that ships, and what lowers a confidence."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import recalibration
from priors.drives import open_drive
from priors.learn.fit_confidence import HELD_BACK, Stated, fit_reading, join, regress
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.nets import weights
from priors.recalibration import BELIEVED, CLASSICAL_STEREO, LogOdds, Recalibration
from priors.types import Depth, FloatMap, Frame

CHANCES = st.lists(st.floats(1e-4, 0.999), min_size=2, max_size=20)
SHIFTS, SLOPES = st.floats(-3, 3), st.floats(0.1, 4)


def column(chances: list[float]) -> FloatMap:
    return np.array([chances], np.float32)


@given(CHANCES, SHIFTS, SLOPES)
@settings(deadline=None)
def test_it_is_a_line_on_the_log_odds(chances: list[float], shift: float, slope: float) -> None:
    found = LogOdds(shift, slope)(column(chances))[0]
    expected = [1 / (1 + math.exp(-(shift + slope * math.log(p / (1 - p))))) for p in map(float, column(chances)[0])]
    assert np.allclose(found, expected, atol=1e-5)
    order = np.argsort(column(chances)[0], kind="stable")
    assert (np.diff(found[order]) >= -1e-6).all()


@given(CHANCES, SHIFTS, SLOPES, SHIFTS, SLOPES)
@settings(deadline=None)
def test_two_after_each_other_are_one(chances: list[float], a: float, b: float, c: float, d: float) -> None:
    first, second = LogOdds(a, b), LogOdds(c, d)
    inside = first(column(chances))
    if inside.min() > 1e-3 and inside.max() < 1 - 1e-3:  # beyond, float32 has no digits left
        assert np.allclose(second(inside), second.after(first)(column(chances)), atol=1e-3)


def test_no_probability_stays_none() -> None:
    depth = Depth(np.ones((1, 3), np.float32), column([0, 0.5, 1]), within_5_percent=column([0, 0.5, 1]))
    mended = Recalibration(LogOdds(2, 0.5), LogOdds(-1, 2))(depth)
    for part in (mended.confidence, mended.within_5_percent):
        assert part is not None and part[0, 0] == 0 and 0 < part[0, 1] < part[0, 2] <= 1
    bare = Recalibration(LogOdds(2, 0.5))(Depth(np.ones((1, 3), np.float32)))
    assert bare.confidence is None and bare.within_5_percent is None


@pytest.mark.parametrize("slope", [0, -1, float("nan"), float("inf")])
def test_a_map_that_does_not_rise_is_refused(slope: float) -> None:
    with pytest.raises(ValueError, match="slope"):
        LogOdds(0, slope)


def test_the_file_is_of_the_weights_that_ship() -> None:
    for name, held in recalibration.read().items():
        if name != CLASSICAL_STEREO:
            file = weights.FOLDER / f"{name}.safetensors"
            assert held["weights"] == weights.digest(file), f"{name}: fit again, see priors/weights/confidence.md"
            assert Recalibration.of(name, held["weights"]) != BELIEVED
    assert Stereo().recalibration() != BELIEVED != Mono().recalibration()


def test_other_weights_are_believed(tmp_path: Path) -> None:
    assert Recalibration.of("cfnet-s", "another digest") == Recalibration.of("none such") == BELIEVED
    file = tmp_path / "bts-m.safetensors"
    weights.rewrite_about(_copy(weights.FOLDER / "bts-m.safetensors", file), note="mine")
    assert Mono(weights=file).recalibration() == BELIEVED


def _copy(source: Path, target: Path) -> Path:
    target.write_bytes(source.read_bytes())
    return target


def stated(seed: int, truth: LogOdds, n: int = 20_000) -> Stated:
    """Pixels whose true probability is a line on the log-odds of what is stated."""
    rng = np.random.default_rng(seed)
    chance = rng.uniform(0.02, 0.98, n)
    return Stated(chance, rng.random(n) < truth(chance.astype(np.float32)))


@pytest.mark.parametrize("truth", [LogOdds(0.8, 0.5), LogOdds(-0.6, 1.9)])
def test_the_fit_finds_what_is_true(truth: LogOdds) -> None:
    seen, fresh = stated(0, truth), stated(1, truth)
    found = regress(seen, np.full(seen.chance.size, 1 / seen.chance.size))
    assert (found.shift, found.slope) == pytest.approx((truth.shift, truth.slope), abs=0.08)
    mended = replace(fresh, chance=found(fresh.chance.astype(np.float32)).astype(np.float64))
    assert mended.error < 0.015 < 0.05 < fresh.error


def test_frames_that_are_held_back_teach_nothing() -> None:
    right, wrong = LogOdds(0.5, 1.2), LogOdds(-2, 0.3)
    parts = {"drive": [stated(0, right)], f"drive, {HELD_BACK}": [stated(1, wrong)]}
    assert fit_reading(parts) == fit_reading({"drive": parts["drive"]})
    assert fit_reading({f"drive, {HELD_BACK}": [stated(1, wrong)]}) == LogOdds()
    assert join([stated(0, right), stated(1, right)]).chance.size == 40_000


def test_what_one_eye_alone_sees_is_less_credible(street: Path) -> None:
    frame = open_drive(street)[0]
    depth = Stereo(offset_px=(0, 0, 0))(frame)
    assert depth.confidence is not None and depth.within_5_percent is not None
    assert frame.baseline_m is not None
    disparity_px = frame.camera.fx * frame.baseline_m / np.where(depth.valid, depth.depth_m, np.inf)
    columns = np.arange(depth.depth_m.shape[1])[None]
    strip, ground = columns < disparity_px - 1, depth.confidence > 0
    near = (depth.depth_m < 15) & ground  # as far away as what lies in the strip
    assert np.count_nonzero(strip & near) > 50
    for reading in (depth.confidence, depth.within_5_percent):
        assert reading[strip & near].mean() < reading[~strip & near].mean() - 0.05


def test_misrectified_pairs_are_less_credible(street: Path) -> None:
    frame = open_drive(street)[0]
    method = Stereo(offset_px=(0, 0, 0), rows_px=0.0)
    level, lower = method(frame), method(lowered(frame, 2))
    for one, other in ((level.trust(), lower.trust()), (level.within_5_percent, lower.within_5_percent)):
        assert one is not None and other is not None
        assert other[other > 0].mean() < one[one > 0].mean() - 0.03


def lowered(frame: Frame, rows: int) -> Frame:
    """The frame with its other image some rows lower, as a bad rectification has it."""
    other = frame.other()
    return replace(frame, readers={**frame.readers, "other": lambda: np.roll(other, rows, axis=0)})


def test_the_end_of_the_range_is_less_credible(street: Path) -> None:
    depth = Stereo(offset_px=(0, 0, 0))(open_drive(street)[0])
    assert depth.within_5_percent is not None
    far, near = (depth.depth_m > 100) & (depth.trust() > 0), (depth.depth_m > 0) & (depth.depth_m < 30)
    assert far.any() and depth.within_5_percent[far].mean() < 0.5 * depth.within_5_percent[near].mean()
