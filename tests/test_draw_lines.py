"""Plots: drawn through their points, in three formats, the same bytes each time; text stays text."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest

from priors.draw import figure
from priors.draw.lines import Line, Plot, draw, svg, write
from priors.errors import DataError

pytestmark = pytest.mark.filterwarnings("error")
X = np.linspace(0, 100, 11)
RISING = Line("rising", X, X / 10)


def plot(*lines: Line, **more: object) -> Plot:
    return Plot(lines, "share, %", "PSNR, dB", **more)  # type: ignore[arg-type]


def rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path))[..., ::-1].astype(int)


def test_a_curve_is_drawn_through_its_points(tmp_path: Path) -> None:
    """A flat 5 between 0 and 10 is half-way up, all along, in the first line's colour."""
    flat, ends = Line("flat", X, np.full(11, 5.0)), Line("", np.array([0.0, 100]), np.array([0.0, 10]))
    figure_ = draw([plot(flat, ends)])
    figure_.axes[0].set_ylim(0, 10)
    box = figure_.axes[0].get_position()
    figure.save(figure_, tmp_path / "a.png")
    picture = rgb(tmp_path / "a.png")
    height, width, _ = picture.shape
    box = figure_.axes[0].get_position()  # as laid out when it was written
    row = round(height * (1 - (box.y0 + box.y1) / 2))
    colour = np.array([int(figure.COLOURS[0][i : i + 2], 16) for i in (1, 3, 5)])
    seen = (np.abs(picture[row - 3 : row + 4] - colour).sum(axis=2).min(axis=0) < 30).nonzero()[0]
    assert seen.min() < width * (box.x0 + 0.1 * (box.x1 - box.x0))
    assert seen.max() > width * (box.x1 - 0.1 * (box.x1 - box.x0))


@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF"), (".SVG", b"<?xml")]
)
def test_the_name_s_ending_is_the_format_and_bytes_are_the_same_each_time(
    tmp_path: Path, suffix: str, begins: bytes
) -> None:
    paths = [tmp_path / "new" / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        write(path, [plot(RISING)])
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(begins)
    assert first == second
    assert {path.name for path in paths[0].parent.iterdir()} == {path.name for path in paths}


def test_other_endings_are_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"a.jpg: expected a plot's name that ends in .png, .svg, .pdf"):
        write(tmp_path / "a.jpg", [plot(RISING)])
    assert not list(tmp_path.iterdir())


def test_an_svg_holds_its_words_as_text() -> None:
    """Searchable, and whatever a name holds: markup, dollars, an underscore first."""
    words = ["_first <b>", "a$b$ & c"]
    drawn = svg([plot(*(Line(word, X, X) for word in words), title="study/one")])
    texts = {element.text for element in ET.fromstring(drawn).iter("{http://www.w3.org/2000/svg}text")}
    assert {*words, "study/one", "share, %", "PSNR, dB"} <= texts
    assert "https://" not in drawn
    assert not re.search(r"<(image|script|metadata)", drawn)


def test_the_user_s_own_style_changes_nothing(tmp_path: Path) -> None:
    write(tmp_path / "a.svg", [plot(RISING)])
    with matplotlib.rc_context(
        {"lines.linewidth": 9, "font.size": 30, "axes.facecolor": "red", "svg.fonttype": "path"}
    ):
        write(tmp_path / "b.svg", [plot(RISING)])
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_the_axis_starts_at_zero_unless_told_otherwise_or_below_it() -> None:
    high = Line("high", X, 20 + X / 100)
    assert draw([plot(high)]).axes[0].get_ylim()[0] == 0
    assert draw([plot(high, from_zero=False)]).axes[0].get_ylim()[0] > 19
    assert draw([plot(Line("low", X, -X))]).axes[0].get_ylim()[0] < -99


def test_one_legend_serves_plots_of_the_same_lines() -> None:
    same = draw([plot(RISING), plot(RISING)], 2)
    assert len(same.legends) == 1
    assert all(axes.get_legend() is None for axes in same.axes)
    other = draw([plot(RISING), plot(Line("other", X, X))], 2)
    assert not other.legends
    assert [axes.get_legend().get_texts()[0].get_text() for axes in other.axes] == ["rising", "other"]


def test_ticks_of_whole_numbers_and_of_a_logarithmic_axis() -> None:
    views = draw([plot(Line("a", np.arange(1.0, 4), X[:3]), x_scale="whole")])
    assert all(float(tick).is_integer() for tick in views.axes[0].get_xticks())
    lines = draw([plot(Line("a", np.array([64.0, 8, 16]), X[:3]), x_scale="log")])
    assert [text.get_text() for text in lines.axes[0].get_xticklabels()] == ["8", "16", "64"]


def test_plots_of_nothing_and_of_gaps_do_not_fail(tmp_path: Path) -> None:
    for y in (np.full(3, np.nan), np.array([1.0, np.nan, np.inf]), np.zeros(3), np.zeros(0)):
        write(tmp_path / "a.png", [plot(Line("gap", np.arange(float(len(y))), y))])
    for plots in ([], [plot()], [plot(), plot()]):
        write(tmp_path / "a.png", plots)
    assert "no values" in svg([plot(Line("gap", np.arange(3.0), np.full(3, np.nan)))])


def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path: Path, full_disk) -> None:
    write(tmp_path / "a.png", [plot(RISING)])
    old = (tmp_path / "a.png").read_bytes()
    with full_disk(1000), pytest.raises(OSError) as told:
        write(tmp_path / "a.png", [plot(Line("other", X, X))])
    assert told.value.filename == str(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == old
    assert len(list(tmp_path.iterdir())) == 1
