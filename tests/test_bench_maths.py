"""What a bench computes: the front, the schedule, the calibration error; each against its slow, obvious version."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.calibration import Tolerance, calibration_error
from priors.bench.front import Worth, on_front
from priors.bench.schedule import Need, schedule

pytestmark = pytest.mark.stress
FEW = st.sampled_from([0.1, 0.2, 0.3])
WORTHS = st.lists(st.builds(Worth, FEW, st.one_of(FEW, st.just(math.nan)), FEW), max_size=8)
NEEDS = st.dictionaries(
    st.text("abc", min_size=1, max_size=2),
    st.builds(Need, st.integers(1, 20), st.floats(0, 20), st.floats(0, 5)),
    min_size=1,
    max_size=6,
)


@given(WORTHS)
def test_the_front_is_what_nothing_beats(worths: list[Worth]) -> None:
    def beaten(a: Worth) -> bool:
        return any(
            b.seconds <= a.seconds
            and b.error <= a.error
            and b.density >= a.density
            and (b.seconds < a.seconds or b.error < a.error or b.density > a.density)
            for b in worths
        )

    assert on_front(worths) == [not math.isnan(worth.error) and not beaten(worth) for worth in worths]


def test_a_sparser_map_is_not_better_for_leaving_the_hard_pixels_out() -> None:
    sparse, dense = Worth(1.0, 0.01, 0.3), Worth(1.0, 0.02, 1.0)
    assert on_front([sparse, dense]) == [True, True]
    assert on_front([sparse, Worth(1.0, 0.01, 1.0)]) == [False, True]


@given(NEEDS, st.floats(0, 500))
def test_a_schedule_ends_in_time(needs: dict[str, Need], limit_s: float) -> None:
    made = schedule(needs, limit_s)
    assert made.frames.keys() == needs.keys()
    assert all(1 <= made.frames[name] <= need.frames for name, need in needs.items())
    assert set(made.shortened) == {name for name, need in needs.items() if made.frames[name] < need.frames}
    cold_s = sum(need.cold_s for need in needs.values())
    assert made.seconds == pytest.approx(cold_s + sum(made.frames[name] * needs[name].seconds for name in needs))
    if cold_s + sum(need.seconds for need in needs.values()) <= limit_s:
        extra = sum(need.seconds for name, need in needs.items() if made.frames[name] == 1)  # one is always made
        assert made.seconds <= limit_s + extra + 1e-6


@given(NEEDS)
def test_who_makes_all_maps_takes_no_longer_than_who_makes_fewer(needs: dict[str, Need]) -> None:
    made = schedule(needs, 30.0)
    spent = {name: made.frames[name] * need.seconds for name, need in needs.items()}
    for slow in made.shortened:
        whole = [name for name in needs if name not in made.shortened and made.frames[name] > 1]  # one is always made
        assert all(spent[name] <= spent[slow] + needs[slow].seconds + 1e-6 for name in whole)


def test_a_perfect_confidence_has_no_calibration_error() -> None:
    drawn = np.random.default_rng(0)
    confidence = drawn.uniform(0, 1, 200_000)
    right = drawn.uniform(0, 1, 200_000) < confidence
    assert calibration_error(confidence, right) < 0.005
    assert calibration_error(np.full(1000, 0.9), np.arange(1000) < 400) == pytest.approx(0.5)
    assert math.isnan(calibration_error(np.zeros(0), np.zeros(0, bool)))


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=60))
def test_the_calibration_error_is_the_mean_gap_of_bins_of_equal_count(values: list[tuple[float, bool]]) -> None:
    confidence, right = (np.array(column) for column in zip(*values, strict=True))
    alike = {said: [true for other, true in values if other == said] for said, _ in values}
    ranked = sorted((said, sum(alike[said]) / len(alike[said])) for said, _ in values)
    bins, gap = min(15, len(values)), 0.0
    for number in range(bins):
        long = len(values) % bins  # the first of them are longer by one
        start = number * (len(values) // bins) + min(number, long)
        part = ranked[start : start + len(values) // bins + (number < long)]
        gap += abs(sum(said for said, _ in part) - sum(true for _, true in part))
    assert calibration_error(confidence, right) == pytest.approx(gap / len(values), abs=1e-9)


@pytest.mark.parametrize(
    ("tolerance", "right", "text"),
    [
        (Tolerance(1.0, "m"), [True, False, True], "1 m"),
        (Tolerance(0.05, "share"), [False, True, True], "5 %"),
        (Tolerance(1.0, "px"), [False, True, True], "1 px"),
    ],
)
def test_a_tolerance_is_of_depth_of_disparity_or_a_share(tolerance: Tolerance, right: list[bool], text: str) -> None:
    prediction_m, truth_m = np.array([10.9, 51.5, 20.0]), np.array([10.0, 50.0, 20.0])
    assert tolerance.within(prediction_m, truth_m, 400.0).tolist() == right  # 400 px m: 3.3, 0.2 and 0 px
    assert str(tolerance) == text
    if tolerance.unit == "px":
        with pytest.raises(ValueError, match="fx_baseline"):
            tolerance.within(prediction_m, truth_m)
