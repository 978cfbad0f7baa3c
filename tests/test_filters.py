"""Filters: they only take away, exactly what they say, the same on every machine."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from priors import filters
from priors.errors import DataError
from priors.filters import Filters
from priors.types import Camera, Depth, Frame

values = st.one_of(st.just(np.float32(0)), st.floats(0.125, 300, width=32).map(np.float32))
shares = st.floats(0, 1)


@st.composite
def depths(draw: st.DrawFn) -> Depth:
    shape = draw(hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))
    depth_m = draw(hnp.arrays(np.float32, shape, elements=values))
    # Few different confidences: ties are the hard case.
    confidence = draw(hnp.arrays(np.float32, shape, elements=st.sampled_from([0, 0.25, 0.5, 0.75, 1]).map(np.float32)))
    return Depth(depth_m, np.where(depth_m > 0, confidence, np.float32(0)))


def make_frame(size: tuple[int, int], id_: str = "000007", **readers: Callable[[], Any]) -> Frame:
    camera = Camera(np.array([[100.0, 0, 0], [0, 100, 0], [0, 0, 1]]), size)
    return Frame(id_, camera, readers, missing={"truth": "no truth: name its folder with --truth"}, baseline_m=0.5)


ACTIVE = [
    Filters(sky_rows=0.34),
    Filters(truth_mask=True),
    Filters(clip=80),
    Filters(confidence=0.5),
    Filters(keep=0.9228),
    Filters(density=0.2),
    Filters(sky_rows=0.2, truth_mask=True, clip=100, confidence=0.25, keep=0.7, density=0.5, density_seed=3),
]


@pytest.mark.parametrize("active", ACTIVE, ids=lambda f: "+".join(f.record()))
@given(depth=depths(), data=st.data())
def test_a_filter_takes_values_away_and_touches_no_other(active: Filters, depth: Depth, data: st.DataObject) -> None:
    truth = Depth(data.draw(hnp.arrays(np.float32, depth.depth_m.shape, elements=values)))
    frame = make_frame(depth.depth_m.shape, truth=lambda: truth)
    before = depth.depth_m.copy(), np.array(depth.confidence)
    after = active(depth, frame)
    kept = after.valid
    np.testing.assert_array_equal(after.depth_m, np.where(kept, depth.depth_m, 0))
    np.testing.assert_array_equal(after.confidence, np.where(kept, depth.confidence, 0))
    np.testing.assert_array_equal(depth.depth_m, before[0])  # the given map is left alone
    np.testing.assert_array_equal(depth.confidence, before[1])
    assert after.depth_m.dtype == np.float32
    np.testing.assert_array_equal(active(depth, frame).depth_m, after.depth_m)  # deterministic
    if active.keep is None and active.density is None:  # a share of a share is smaller, all others repeat
        np.testing.assert_array_equal(active(after, frame).depth_m, after.depth_m)


def test_no_filter_is_no_change_and_no_record() -> None:
    depth = Depth(np.ones((2, 2), np.float32))
    assert Filters()(depth, make_frame((2, 2))) is depth
    assert Filters().record() == {}


def test_clip_invalidates_and_keeps_the_limit_itself() -> None:
    limit = np.float32(80.1)
    row = [[79, 80.1, np.nextafter(limit, np.float32(99)), 1e30, np.inf, np.nan, 0]]
    clipped = filters.clip(Depth(np.array(row, np.float32)), 80.1)
    np.testing.assert_array_equal(clipped.depth_m, np.array([[79, 80.1, 0, 0, 0, 0, 0]], np.float32))


@pytest.mark.parametrize(("fraction", "rows"), [(0, 0), (0.32, 120), (0.3173, 119), (0.36, 135), (1, 375)])
def test_row_crop_takes_the_rounded_number_of_top_rows(fraction: float, rows: int) -> None:
    cropped = filters.crop_rows(Depth(np.ones((375, 2), np.float32)), fraction)
    np.testing.assert_array_equal(cropped.valid.all(axis=1), np.arange(375) >= rows)


@given(depths(), shares)
def test_keep_takes_exactly_the_best_even_with_ties(depth: Depth, fraction: float) -> None:
    kept = filters.keep_best(depth, fraction)
    count = math.floor(fraction * np.count_nonzero(depth.valid) + 0.5)
    assert np.count_nonzero(kept.valid) == count
    dropped = depth.valid & ~kept.valid
    if count and dropped.any():
        assert depth.confidence is not None
        assert depth.confidence[kept.valid].min() >= depth.confidence[dropped].max()


def test_keep_breaks_ties_all_over_the_image() -> None:
    flat = Depth(np.ones((100, 100), np.float32), np.ones((100, 100), np.float32))
    top, bottom = np.split(filters.keep_best(flat, 0.5).valid, 2)
    assert abs(np.mean(top) - np.mean(bottom)) < 0.05


def test_confidence_at_the_threshold_stays_and_nan_is_no_confidence() -> None:
    confidence = np.array([[0.9, np.nextafter(np.float32(0.9), np.float32(0)), np.nan, 1]], np.float32)
    depth = Depth(np.ones((1, 4), np.float32), confidence)
    np.testing.assert_array_equal(filters.keep_confident(depth, 0.9).valid, [[True, False, False, True]])
    np.testing.assert_array_equal(filters.keep_best(depth, 0.25).valid, [[False, False, False, True]])


@pytest.mark.parametrize("active", [Filters(confidence=0.9), Filters(keep=0.9)])
def test_filtering_by_a_confidence_that_is_not_there_says_so(active: Filters) -> None:
    with pytest.raises(DataError, match="no confidence"):
        active(Depth(np.ones((2, 2), np.float32)), make_frame((2, 2)))


@given(depths(), shares, shares, st.integers(0, 99))
def test_density_is_exact_and_sparser_is_a_subset(depth: Depth, a: float, b: float, seed: int) -> None:
    less, more = (filters.keep_random(depth, fraction, seed).valid for fraction in sorted((a, b)))
    assert np.count_nonzero(less) == math.floor(min(a, b) * np.count_nonzero(depth.valid) + 0.5)
    assert not (less & ~more).any()


def test_density_draws_by_seed_and_frame_not_by_order() -> None:
    depth = Depth(np.ones((40, 40), np.float32))
    first, second = make_frame((40, 40), "000001"), make_frame((40, 40), "000002")
    alone = Filters(density=0.5)(depth, second).valid
    Filters(density=0.5)(depth, first)  # another shard's frame changes nothing
    np.testing.assert_array_equal(Filters(density=0.5)(depth, second).valid, alone)
    for other in (Filters(density=0.5)(depth, first), Filters(density=0.5, density_seed=1)(depth, second)):
        assert 0.4 < np.mean(other.valid == alone) < 0.6
    # Written down: another numpy or machine must draw the same, or caches would mix.
    assert filters.frame_seed(0, "000002") == 691217318734156231
    assert np.flatnonzero(alone)[:8].tolist() == [0, 1, 3, 4, 7, 11, 14, 15]


def test_truth_mask_needs_a_truth() -> None:
    depth = Depth(np.ones((1, 3), np.float32))
    truth = Depth(np.array([[5, 0, 7]], np.float32))
    kept = Filters(truth_mask=True)(depth, make_frame((1, 3), truth=lambda: truth))
    np.testing.assert_array_equal(kept.depth_m, [[1, 0, 1]])
    with pytest.raises(DataError, match="--truth"):
        Filters(truth_mask=True)(depth, make_frame((1, 3)))


def test_left_right_keeps_what_the_other_view_confirms() -> None:
    disparity_px = np.array([[2, 2, 2, 2, 2, 2, 0, 1]], np.float32)
    other_px = np.array([[2, 2.9, 3.5, 0, 2, 2, 2, 2]], np.float32)
    depth = Depth(np.where(disparity_px > 0, 50, 0).astype(np.float32))
    # Columns 2..5 land on 0..3: agrees, within 1 px, too different, no value there. 0 and 1 land outside.
    left = filters.keep_agreeing(depth, other_px, disparity_px, -1, 1.0)
    np.testing.assert_array_equal(left.valid, [[False, False, True, True, False, False, False, True]])
    # The right eye's points lie further right in the left image.
    right = filters.keep_agreeing(depth, other_px, disparity_px, +1, 1.0)
    np.testing.assert_array_equal(right.valid, [[False, False, True, True, True, True, False, False]])


def shifted_pair(shift: int) -> tuple[np.ndarray, np.ndarray]:
    import cv2

    noise = np.random.default_rng(0).uniform(0, 255, (120, 400 + shift)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return texture[:, :400], texture[:, shift:]  # left x matches right x - shift


@pytest.mark.parametrize("side", ["left", "right"])
def test_left_right_drops_wrong_values_of_either_eye(side: Any) -> None:
    pair = shifted_pair(20)
    this, other = pair if side == "left" else pair[::-1]
    frame = dataclasses.replace(
        make_frame(this.shape, image=lambda: this.copy(), other=lambda: other.copy()), side=side
    )
    disparity_px = np.full(this.shape, 20, np.float32)
    disparity_px[40:80, 150:250] = 26  # wrong by 6 px
    kept = Filters(left_right=1.5)(Depth(np.float32(100 * 0.5) / disparity_px), frame).valid
    inner = np.zeros(this.shape, bool)
    inner[10:110, 60:340] = True
    assert not kept[40:80, 150:250].any()
    inner[38:82, 148:252] = False
    assert np.mean(kept[inner]) > 0.9


def test_left_right_needs_a_baseline() -> None:
    image = np.zeros((60, 80), np.uint8)
    frame = make_frame((60, 80), image=lambda: image, other=lambda: image)
    with pytest.raises(DataError, match="baseline"):
        Filters(left_right=1)(Depth(np.ones((60, 80), np.float32)), dataclasses.replace(frame, baseline_m=None))


def test_order_is_what_the_docstring_says() -> None:
    active = Filters("mask", 0.3, True, 80, 1.5, 0.5, 0.9, 0.2)
    expected = ["SkyMask", "SkyRows", "TruthMask", "Clip", "LeftRight", "Confidence", "Keep", "Density"]
    assert list(active.record()) == expected
    fields = [field.name for field in dataclasses.fields(Filters) if field.name not in ("density_seed", "keep_by")]
    assert len(fields) == len(expected)


def test_shares_are_of_what_the_other_filters_leave() -> None:
    depth_m = np.array([[10, 20, 100, 100]], np.float32)
    depth = Depth(depth_m, np.array([[0.1, 0.2, 0.9, 0.9]], np.float32))
    np.testing.assert_array_equal(Filters(clip=80, keep=0.5)(depth, make_frame((1, 4))).depth_m, [[0, 20, 0, 0]])


def test_record_tells_every_setting_that_matters_and_no_other() -> None:
    assert Filters(clip=80).record() == Filters(clip=80.0).record() == {"Clip": {"farthest_m": 80.0}}
    assert Filters(density_seed=5).record() == {}
    assert Filters(density=0.2, density_seed=5).record() != Filters(density=0.2, density_seed=6).record()
    assert "version" in Filters(sky="mask").record()["SkyMask"]


@pytest.mark.parametrize(
    "bad",
    [{"clip": -1}, {"clip": math.nan}, {"keep": 1.5}, {"density": -0.1}, {"sky_rows": 2}, {"left_right": -1}],
)
def test_a_setting_out_of_range_names_its_flag(bad: dict[str, float]) -> None:
    with pytest.raises(DataError, match="--" + next(iter(bad)).replace("_", "-")):
        Filters(**bad)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (3, 4)])
def test_a_map_without_values_passes_every_filter(shape: tuple[int, int]) -> None:
    empty = Depth(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    active = Filters(sky_rows=0.5, clip=80, confidence=0.5, keep=0.5, density=0.5)
    assert not active(empty, make_frame(shape)).valid.any()


def sure_map() -> Depth:
    """Near and far values that are as likely right within 5 %, and one that is less."""
    depth_m = np.array([[2, 20, 80, 20]], np.float32)
    return Depth(depth_m, np.full((1, 4), 0.5, np.float32), within_5_percent=np.float32([[0.9, 0.9, 0.9, 0.6]]))


def test_keep_by_says_which_error_sorts() -> None:
    """Of equal relative errors the nearest is best in metres and, by its disparity, worst in pixels."""
    frame, depth = make_frame((1, 4)), sure_map()

    def left(**flags: Any) -> list[float]:
        kept = Filters(**flags)(depth, frame)
        assert kept.confidence is not None and set(np.unique(kept.confidence)) <= {0, 0.5}, "it is the method's own"
        return kept.depth_m[kept.valid].tolist()

    assert left(keep=0.25, keep_by="metres") == [2]
    assert left(keep=0.75, keep_by="pixels") == [20, 80, 20]
    assert left(keep=0.75, keep_by="relative") == [2, 20, 80]
    assert left(confidence=0.7, keep_by="relative") == [2, 20, 80]
    assert left(confidence=0.8, keep_by="metres") == [2, 20], "5 % of 20 m is a metre: as likely"


def test_keep_by_needs_what_it_reads() -> None:
    alone = dataclasses.replace(make_frame((1, 4)), baseline_m=None)
    with pytest.raises(DataError, match="000007: --keep-by pixels: it has no stereo pair"):
        Filters(keep=0.5, keep_by="pixels")(sure_map(), alone)
    with pytest.raises(DataError, match="--keep-by metres: the map does not tell its relative error"):
        Filters(keep=0.5, keep_by="metres")(dataclasses.replace(sure_map(), within_5_percent=None), alone)
    with pytest.raises(DataError, match="--keep-by relative: expected --keep or --confidence beside it"):
        Filters(keep_by="relative")
    with pytest.raises(DataError, match="--keep-by size: expected metres"):
        Filters(keep=0.5, keep_by="size")  # type: ignore[arg-type]
    assert Filters(keep=0.5).record() == {"Keep": {"fraction": 0.5}}, "keys stay what they were"
    assert Filters(keep=0.5, keep_by="metres").record() == {"KeepBy": {"fraction": 0.5, "by": "metres"}}
