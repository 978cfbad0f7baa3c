"""Tables: the right figures marked, every format readable, nothing compared that must not be."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from eval import table
from eval.protocol import ScoreError, preset
from eval.result import score
from eval.typeset import rank

pytestmark = pytest.mark.filterwarnings("error")


def make(name, factor, frames=2, protocol="uncapped", keep=1.0, fx_baseline=None):
    """A prior that is off by a factor everywhere and has a value in a share of the columns."""
    truth = np.tile(np.linspace(4, 40, 20), (3, 1))
    prediction = np.where(np.arange(20) < 20 * keep, truth * factor, 0)
    rows = ((f"{i:010d}", prediction, None, truth) for i in range(frames))
    return score(rows, preset(protocol), fx_baseline, {"prior": name})


@pytest.fixture
def three():
    return [make("lidar", 1.01), make("stereo_a&b", 1.3), make("mono|1", 1.1)]


def marks_of(results, key):
    return [row[0] for row in table.table_of(results, [key]).marks]


def test_best_is_bold_and_second_underlined_by_each_metric_s_direction(three):
    assert marks_of(three, "abs_rel") == ["bold", "", "underline"]  # less is better
    assert marks_of(three, "delta_1") == ["bold", "underline", "bold"]  # more is better, equals share
    assert marks_of(three, "silog") == ["", "", ""]  # all alike: no best
    assert marks_of(three[:1], "abs_rel") == [""]  # nothing to compare with


def test_ranks_are_of_printed_figures_and_leave_out_what_is_missing():
    assert rank(["0.10", "0.10", "-", "0.20"], higher=False) == ["bold", "bold", "", "underline"]
    assert rank(["9.00", "10.00"], higher=True) == ["underline", "bold"]
    assert rank(["-", "-"], higher=True) == ["", ""]
    empty = score([], preset("uncapped"), info={"prior": "none"})
    assert table.table_of([make("a", 1.1), empty], ["rmse"]).cells[1] == ["-"]


def test_figures_are_printed_in_their_units():
    one = make("x", 1.1, keep=0.5, fx_baseline=386.0)
    laid = table.table_of([one], ["density", "abs_rel", "delta_1", "d1"])
    assert laid.cells == [["50.0", "0.1000", "1.0000", f"{one.metrics()['d1']:.2f}"]]
    assert [column.title for column in laid.columns] == ["density % ↑", "AbsRel ↓", "δ<1.25 ↑", "D1 % ↓"]


def test_other_protocols_are_refused_by_every_writer(three, tmp_path):
    mixed = [three[0], make("paper", 1.0, protocol="paper")]
    for write in (table.table_of, table.render, table.plain, table.markdown, table.latex, table.as_csv, table.show):
        with pytest.raises(ScoreError, match="lidar and paper were scored by different protocols"):
            write(mixed)
    with pytest.raises(ScoreError, match="different protocols"):
        table.save([("", mixed)], tmp_path / "t.csv")
    assert not list(tmp_path.iterdir())


def test_other_frames_truth_and_density_are_said():
    a, fewer, sparse = make("a", 1.1), make("b", 1.1, frames=1), make("c", 1.1, keep=0.5)
    assert table.notes([a, make("d", 1.2)]) == []
    assert table.notes([a, fewer]) == ["b covers 1 of 2 frames: not 0000000001"]
    assert table.notes([a, sparse]) == ["errors are over each row's own pixels: with other densities, other pixels"]
    frames = ((f"{i:010d}", np.ones((2, 2)), None, np.ones((2, 2))) for i in range(2))
    other = score(frames, preset("uncapped"), info={"prior": "e"})
    assert table.notes([a, other]) == ["same frames, but 8 to 120 truth pixels: the truth is not the same"]
    for write in (table.plain, table.markdown, table.latex):
        assert "b covers 1 of 2 frames" in write([a, fewer])


def test_markdown(three):
    lines = table.markdown(three, ["abs_rel", "rmse"]).splitlines()
    assert lines[0] == "| prior | AbsRel ↓ | RMSE m ↓ |"
    assert lines[1] == "|---|---:|---:|"
    assert lines[2].startswith("| lidar | **0.0100** | **")
    assert lines[4].startswith(r"| mono\|1 | <u>0.1000</u> |")
    assert "uncapped: annotated truth" in lines[6]
    assert "2 frames, 120 truth pixels" in lines[6]


def test_latex(three):
    text = table.latex(three, ["abs_rel", "delta_2"])
    assert r"prior & AbsRel $\downarrow$ & $\delta<$1.25$^2$ $\uparrow$ \\" in text
    assert r"lidar & \textbf{0.0100} & 1.0000 \\" in text
    assert r"stereo\_a\&b & 0.3000 & 1.0000 \\" in text
    assert r"\underline{0.1000}" in text
    assert text.count("{") == text.count("}")
    assert r"\begin{tabular}{lrr}" in text


def test_csv_holds_every_figure_in_full_and_both_poolings(three):
    rows = list(csv.DictReader(io.StringIO(table.as_csv(three))))
    assert [(row["prior"], row["pooling"]) for row in rows[:2]] == [("lidar", "image"), ("lidar", "pixel")]
    assert len(rows) == 6
    assert float(rows[0]["rmse"]) == three[0].metrics("image")["rmse"]
    assert rows[0]["d1"] == ""  # no rig, no disparity
    assert set(table.COLUMNS) <= rows[0].keys()


def test_save_writes_by_suffix_and_names_the_choice(three, tmp_path):
    for suffix, start in {".md": "| prior", ".tex": "% ", ".csv": "prior,", ".txt": "prior "}.items():
        table.save([("", three)], tmp_path / "new" / f"t{suffix}")
        assert (tmp_path / "new" / f"t{suffix}").read_text().startswith(start)
    with pytest.raises(ScoreError, match=r"t.xls: expected a table ending in .md, .tex, .csv, .txt"):
        table.save([("", three)], tmp_path / "t.xls")


def test_piped_output_is_plain_aligned_text(three):
    file = io.StringIO()
    table.show(three, console=Console(file=file, width=20))
    lines = file.getvalue().splitlines()
    assert "\x1b" not in file.getvalue()
    assert lines[0].split()[0] == "prior"
    assert len({len(line) for line in lines[:4]}) == 1
    assert lines[1].split()[:3] == ["lidar", "100.0", "0.0100"]


@pytest.mark.parametrize("width", [40, 60, 80, 106, 107, 160])
def test_a_terminal_shows_whole_figures_and_names_what_does_not_fit(three, width):
    file = io.StringIO()
    table.show(three, console=Console(file=file, width=width, force_terminal=True, color_system="standard"))
    text = file.getvalue()
    assert "…" not in text
    assert "\x1b[1m0.0100" in text  # bold, and only the figure
    assert ("no room for" in text) == (width < 107)


def test_columns_can_be_chosen_and_unknown_ones_are_named(three):
    assert len(table.table_of(three, ["mae"]).columns) == 1
    with pytest.raises(ScoreError, match="no metric 'best': choose of density, "):
        table.table_of(three, ["best"])
    with pytest.raises(ScoreError, match="no results to show"):
        table.table_of([])


def test_usual_columns_follow_the_protocol(three):
    stereo = make("s", 1.1, protocol="stereo2015", fx_baseline=386.0)
    assert "D1 % ↓" in table.plain([stereo])
    assert "-" not in table.table_of([stereo]).cells[0]
    assert "D1" not in table.plain(three)
    renamed = [replace(r, info={}) for r in three[:1]]
    assert table.plain(renamed).splitlines()[1].startswith("prior ")


def test_a_narrow_terminal_shows_what_people_look_at_first(three):
    screen = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    table.show(three, console=screen)
    heads = screen.file.getvalue().partition("─")[0]
    places = [heads.index(title) for title in ("AbsRel", "RMSE", "δ<1.25", "density")]
    assert places == sorted(places) and "δ<1.25²" not in heads
    table.show(three, ["sq_rel"], screen)
    assert "SqRel" in screen.file.getvalue()


def test_long_names_are_folded_before_figures_are_left_out(three):
    long = [replace(r, info={"prior": f"{r.name} offset-px=0.42,-0.31,1.1,-0.7 scale=0.98 + Clip 40"}) for r in three]
    file = io.StringIO()
    table.show(long, console=Console(file=file, width=80, force_terminal=True))
    text = file.getvalue()
    assert "…" not in text and max(map(len, Text.from_ansi(text).plain.splitlines())) <= 80
    for shown in ("AbsRel", "RMSE", "δ<1.25", "density", "0.0100", "Clip 40"):
        assert shown in text


def test_names_are_no_markup(three):
    file = io.StringIO()
    odd = replace(three[0], info={"prior": "[/x] [red]a"})
    table.show([odd], console=Console(file=file, width=200, force_terminal=True))
    assert "[/x] [red]a" in file.getvalue()
