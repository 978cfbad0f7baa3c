"""The error-time plot: every method is named beside its own dot, no name covers another, the front is drawn."""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.draw.scatter import Dot, Scatter, draw

DOTS = st.lists(st.tuples(st.floats(1, 20_000), st.floats(0.005, 0.1), st.integers(0, 8)), min_size=1, max_size=8)


@settings(max_examples=15, deadline=None)
@given(DOTS)
def test_names_do_not_cover_each_other(found: list) -> None:
    dots = [Dot(f"method {i}", ms, error, str(family)) for i, (ms, error, family) in enumerate(found)]
    axes = draw(Scatter(dots, "AbsRel", "title")).axes[0]
    assert {text.get_text() for text in axes.texts} == {dot.label for dot in dots}
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    low, high = axes.get_xlim()
    assert low <= min(dot.milliseconds for dot in dots) and 1.6 * max(dot.milliseconds for dot in dots) <= high


def test_it_is_written_by_its_name_s_ending(tmp_path: Path) -> None:
    dots = [Dot("SGBM", 67, 0.02), Dot("ours", 138, 0.0167, "1")]
    Scatter(dots, "AbsRel", "title").write(tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert all(f">{word}</text>" in text for word in ("SGBM", "ours", "AbsRel", "time a frame", "100 ms"))


def test_the_front_falls_from_step_to_step() -> None:
    dots = [Dot("a", 10, 0.05, on_front=True), Dot("b", 20, 0.08, on_front=True), Dot("c", 40, 0.02, on_front=True)]
    plot = Scatter([*dots, Dot("d", 50, 0.06)], "AbsRel")
    (front, *_) = draw(plot).axes[0].lines
    np.testing.assert_array_equal(front.get_xydata(), [(10, 0.05), (20, 0.05), (40, 0.02)])
    assert front.get_drawstyle() == "steps-post"
    assert plot.says() == "AbsRel over time a frame of 4 methods; no other beats a, b, c"


def test_without_a_front_there_is_no_line() -> None:
    assert len(draw(Scatter([Dot("a", 10, 0.05, "x"), Dot("b", 20, 0.08, "y")], "AbsRel")).axes[0].lines) == 2
