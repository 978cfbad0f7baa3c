"""Results: pooling, ranges, the file, and what must not be joined."""

import gc
import json
import math
import weakref
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import eval as loops

from eval.depth import DepthSums
from eval.protocol import Protocol, ScoreError, preset
from eval.result import Result, score
from eval.stereo import DisparitySums

pytestmark = pytest.mark.filterwarnings("error")

FX_BASELINE = 386.0


def make_frames(count=3, seed=0, confidence=True, size=(8, 12)):
    """Frames with gaps in both maps, far values and, where asked, a confidence."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        truth = np.where(rng.random(size) < 0.7, rng.uniform(1, 100, size), 0).astype(np.float32)
        prediction = np.where(rng.random(size) < 0.8, truth * rng.uniform(0.8, 1.3, size), 0).astype(np.float32)
        yield f"{i:010d}", prediction, rng.random(size) if confidence else None, truth


@pytest.fixture
def result():
    return score(make_frames(), preset("uncapped"), FX_BASELINE, {"prior": "stereo"})


def test_pixel_pooling_is_one_image_of_all_pixels(result):
    frames = list(make_frames())
    prediction, truth = np.hstack([f[1] for f in frames]), np.hstack([f[3] for f in frames])
    expected = loops.depth_metrics(prediction.ravel().tolist(), truth.ravel().tolist())
    expected |= DisparitySums.over_depths(prediction, truth, FX_BASELINE).finish()
    pooled = result.metrics("pixel")
    for key, value in expected.items():
        assert pooled[key] == pytest.approx(value, rel=1e-9), key


def test_image_pooling_is_the_mean_of_the_frames_figures(result):
    each = [loops.depth_metrics(p.ravel().tolist(), t.ravel().tolist()) for _, p, _, t in make_frames()]
    pooled = result.metrics("image")
    for key in each[0]:
        assert pooled[key] == pytest.approx(np.mean([figures[key] for figures in each]), rel=1e-9), key
    assert pooled["rmse"] != pytest.approx(result.metrics("pixel")["rmse"], rel=1e-6)
    assert result.metrics() == pooled  # what the protocol says


def test_a_frame_without_a_prediction_lowers_density_and_leaves_the_errors():
    good = ("a", np.full((2, 2), 9.0), None, np.full((2, 2), 10.0))
    empty = ("b", np.zeros((2, 2)), None, np.full((2, 2), 10.0))
    blind = ("c", np.full((2, 2), 9.0), None, np.zeros((2, 2)))
    both = score([good, empty, blind], preset("paper")).metrics("image")
    assert both["abs_rel"] == pytest.approx(0.1)
    assert both["density"] == 0.5  # the frame without truth has no density
    assert both["density_image"] == pytest.approx(2 / 3)


def test_no_frames_and_empty_maps_are_nan_and_silent(tmp_path):
    nothing = score([], preset("paper"), FX_BASELINE)
    blank = score([("a", np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)))], preset("paper"), FX_BASELINE)
    for result in (nothing, blank):
        for pooling in ("image", "pixel"):
            assert math.isnan(result.metrics(pooling)["abs_rel"])
        assert result.sums.count == 0
        result.save(tmp_path / "metrics.json")
        assert math.isnan(Result.load(tmp_path / "metrics.json").metrics()["rmse"])
    assert "NaN" not in (tmp_path / "metrics.json").read_text()


def test_ranges_split_the_scored_pixels(result):
    ranges = result.by_range("pixel")
    assert [edges for edges, _ in ranges] == [(0, 10), (10, 20), (20, 40), (40, 80), (80, math.inf)]
    frames = list(make_frames())
    p, t = np.hstack([f[1] for f in frames]), np.hstack([f[3] for f in frames])
    for (low, high), figures in ranges:
        part = DepthSums.over(p, np.where((t >= low) & (t < high), t, 0)).finish()
        for key in ("abs_rel", "rmse", "silog", "density"):
            assert figures[key] == pytest.approx(part[key], rel=1e-9)
    assert sum(part.count for row in result.rows for part in row.ranges) == result.sums.count


def test_a_range_holds_its_start_and_not_its_end():
    truth = np.array([[9.99, 10.0, 20.0, 40.0]])
    (row,) = score([("a", truth, None, truth)], preset("uncapped")).rows
    assert [part.count for part in row.ranges] == [1, 1, 1, 1, 0]


def test_a_capped_protocol_has_no_range_beyond_its_cap():
    assert preset("paper").bins()[-1] == (40, 80)


def test_merging_equals_scoring_at_once(result):
    frames = list(make_frames())
    parts = [score(part, preset("uncapped"), FX_BASELINE, result.info) for part in (frames[:1], frames[1:])]
    assert parts[0] + parts[1] == result


def test_merging_refuses_other_protocols_and_the_same_frame(result):
    with pytest.raises(ScoreError, match="frame 0000000000 is in both"):
        result + result
    other = score([], preset("garg"), info={"prior": "lidar"})
    with pytest.raises(ScoreError, match=r"stereo and lidar were scored by different protocols \(uncapped: .*garg: "):
        result + other
    with pytest.raises(ScoreError, match="rendered truth"):
        result + replace(other, protocol=replace(result.protocol, truth="rendered"))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 4), st.integers(0, 9), st.booleans(), st.sampled_from([None, 386.0]))
def test_a_saved_result_is_read_back_equal(tmp_path_factory, count, seed, confidence, fx_baseline):
    path = tmp_path_factory.mktemp("results") / "deep" / "metrics.json"
    info = {"prior": "x", "config": {"a": [1, None]}}
    result = score(make_frames(count, seed, confidence), preset("kitti-completion"), fx_baseline, info)
    result.save(path)
    assert Result.load(path) == result
    assert [item.name for item in path.parent.iterdir()] == ["metrics.json"]  # no temporary file is left


def test_the_file_can_be_read_without_us(result, tmp_path):
    result.save(tmp_path / "metrics.json")
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert content["protocol"]["name"] == "uncapped"
    assert content["metrics"]["pixel"]["rmse"] == pytest.approx(result.metrics("pixel")["rmse"])
    assert content["frames"][1]["frame"] == "0000000001"
    assert content["frames"][1]["metrics"]["abs_rel"] == pytest.approx(result.rows[1].metrics()["abs_rel"])
    assert content["ranges"][-1]["to_m"] is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected a metrics file"),
        ('{"format": 1', "expected a metrics file"),
        ("[1]", "expected a metrics file"),
        ('{"format": 1, "protocol": {"name": "x"}}', "expected a metrics file"),
        ('{"format": 99}', "metrics of format 99, expected 1"),
    ],
)
def test_a_damaged_file_is_named(tmp_path, content, message):
    path = tmp_path / "metrics.json"
    path.write_text(content)
    with pytest.raises(ScoreError, match=message) as caught:
        Result.load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScoreError, match=r"nowhere.json: cannot be read"):
        Result.load(tmp_path / "nowhere.json")


def test_a_frame_of_another_size_is_named():
    frames = [("0000000007", np.ones((2, 3)), None, np.ones((2, 4)))]
    with pytest.raises(ScoreError, match=r"frame 0000000007: prediction is 2x3, truth 2x4"):
        score(frames, preset("paper"))
    frames = [("0000000007", np.ones((2, 4)), np.ones((2, 3)), np.ones((2, 4)))]
    with pytest.raises(ScoreError, match=r"frame 0000000007: confidence is 2x3"):
        score(frames, preset("paper"))


def test_no_frame_is_held_while_the_next_is_read():
    made = []

    def frames():
        for i in range(5):
            prediction = np.ones((4, 5))
            made.append(weakref.ref(prediction))
            yield str(i), prediction, None, np.ones((4, 5))
            del prediction
            gc.collect()
            assert sum(ref() is not None for ref in made) <= 1  # the one that the loop's variable still names

    assert len(score(frames(), preset("paper")).rows) == 5


def test_ause_is_small_for_a_good_confidence_and_absent_without_one():
    def frames(trust):
        for id_, p, _, t in make_frames(3, size=(40, 60)):
            error = np.abs(p - t) / np.maximum(t, 1)
            yield id_, p, trust(error), t

    good, bad, none = (
        score(frames(trust), preset("uncapped")).metrics()
        for trust in (lambda error: -error, lambda error: error, lambda error: None)
    )
    assert good["ause_abs_rel"] == pytest.approx(0, abs=1e-9)
    assert bad["ause_abs_rel"] > 0.05
    assert "ause_abs_rel" not in none


def test_protocols_with_other_ranges_do_not_compare():
    a, b = (score([], Protocol("x", ranges_m=edges)) for edges in ((0.0, 10.0), (0.0, 20.0)))
    with pytest.raises(ScoreError):
        a + b
