"""The benchmarks' error-time plot: every method is named beside its own dot, and no name covers another."""

import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parent / "bench"))
import scatter

DOTS = st.lists(st.tuples(st.floats(1, 20_000), st.floats(0.005, 0.1), st.integers(0, 8)), min_size=1, max_size=8)


@settings(max_examples=15, deadline=None)
@given(DOTS)
def test_names_do_not_cover_each_other(found: list) -> None:
    dots = [scatter.Dot(f"method {i}", ms, error, family) for i, (ms, error, family) in enumerate(found)]
    drawn: list[Figure] = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(scatter, "save", lambda figure, path: drawn.append(figure))
        scatter.write_scatter(Path("a.svg"), dots, "AbsRel", "title")
    axes = drawn[0].axes[0]
    assert {text.get_text() for text in axes.texts} == {dot.label for dot in dots}
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    low, high = axes.get_xlim()
    assert low <= min(dot.milliseconds for dot in dots) and 1.6 * max(dot.milliseconds for dot in dots) <= high


def test_it_is_written_by_its_name_s_ending(tmp_path: Path) -> None:
    dots = [scatter.Dot("SGBM", 67, 0.02), scatter.Dot("ours", 138, 0.0167, 1)]
    scatter.write_scatter(tmp_path / "a.svg", dots, "AbsRel", "title")
    text = (tmp_path / "a.svg").read_text()
    assert all(f">{word}</text>" in text for word in ("SGBM", "ours", "AbsRel", "time a frame", "100 ms"))
