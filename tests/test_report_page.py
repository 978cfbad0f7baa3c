"""The report page: well-formed, self-contained, and safe whatever things are called."""

import base64
import hashlib
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.curves import ScoredPixels, curves
from eval.protocol import preset
from eval.result import Result, score
from eval.typeset import Column, lay_out
from priors.draw.colours import colour_depth, colour_error
from priors.draw.lines import Line, Plot
from priors.report.blocks import Clip, Commands, Figure, KeyFigure, KeyFigures, Paragraph, Ranking, Record, Records
from priors.report.legend import depth_legend, error_legend, hexadecimal
from priors.report.page import Chapter, Page, Section
from priors.report.scores import DriveScores, by_range, scores_page, sparsification
from priors.report.wipe import Kind, View, Wipe, coloured, fit_into, photograph, shown_size

VOID = {"meta", "img", "br", "hr", "link", "input"}
X = np.arange(4.0)


class Reader(HTMLParser):
    """Reads a page as a strict browser would: every element is closed, in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attributes:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "clip-path") or "url(" in (value or ""):
                self.links.append(value or "")

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def wipe(name: str, frames: int = 2, size: tuple[int, int] = (20, 30)) -> Wipe:
    """Frames whose brightness tells their number, with a depth that tells it too."""
    views = []
    for number in range(frames):
        grey = np.full((*size, 3), 40 + 20 * number, np.uint8)
        depth = colour_depth(np.full(size, 10.0 + number, np.float32))
        views.append(
            View(
                f"{name}{number}",
                [photograph("drive", "image", grey, size), coloured(name, "depth", depth, size, name)],
            )
        )
    kinds = {"image": Kind("image"), "depth": Kind("depth", depth_legend())}
    return Wipe(views, size, kinds, ("drive", "image"), (name, "depth"), "source", {}, name)


def page(name: str = "a") -> Page:
    plots = [Plot([Line(name, X, X**2)], "x, m", "y, dB", name)]
    rows = [((name,), {"psnr": 20.0}), (("b",), {"psnr": 21.0}), (("c",), {})]
    table = lay_out(("run",), {"psnr": Column("PSNR", "dB", higher=True, digits=2)}, rows, name, [name])
    sections = [
        Section("Table", [Ranking(table), KeyFigures([KeyFigure(name, "1", "2", "m", name)]), Paragraph(name)]),
        Section("Plots", [Figure(plots, caption=name), Figure([*plots, Plot([Line("c", X, X)], "x", "y")])]),
        Section("Frames", [wipe(name)]),
        Section("Videos", [Clip(name, b"no video")]),
        Section("Settings", [Records([Record(name, {name: name}, [name])])]),
        Section("Nothing", []),
        Section("Commands", [Commands([f"nerf fit {name}"])]),
    ]
    return Page(f"Of {name}", name, [Chapter(name, name, sections)], f"priors eval {name}")


def test_a_page_is_whole_and_loads_nothing() -> None:
    html = page().html()
    read = Reader(html)
    assert not read.open
    assert len(read.ids) == len(set(read.ids)) > 10
    for link in read.links:
        if link.startswith("data:"):
            assert link.startswith("data:video/mp4;base64,")
        elif "#" in link:
            assert link.split("#")[1].rstrip(")") in read.ids, "what a drawing or a link refers to is in the page"
        else:
            assert link.startswith("background:"), link
    assert not {"link", "iframe", "object"} & set(read.tags)
    assert read.text.count("Nothing") == 0, "an empty section has no heading"
    assert "default-src 'none'" in html, "a browser refuses to load anything"


def test_only_the_page_s_own_script_runs() -> None:
    """The policy names the script by its hash, so that what slipped in would not run."""
    html = page().html()
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in html.replace("&#39;", "'")


def test_a_page_says_what_it_was_given() -> None:
    html = page().html()
    assert re.search(r'<td class="figure bold" data-value="21.0">21.00</td>', html)
    assert re.search(r'<td class="figure underline" data-value="20.0">20.00</td>', html)
    assert re.search(r'<td class="figure" data-value="">-</td>', html)
    assert html.count('<svg aria-hidden="true" xmlns') == 3
    assert "priors eval a</pre>" in html
    assert len(html) < 120_000


def test_pictures_are_kept_as_they_were() -> None:
    made = wipe("stereo", frames=3)
    content = made.content
    assert [view["id"] for view in content["views"]] == ["stereo0", "stereo1", "stereo2"]
    for number, view in enumerate(content["views"]):
        image, depth = (decoded(view["layers"][side][0]) for side in (0, 1))
        assert np.abs(image.astype(int) - (40 + 20 * number)).max() < 3
        assert (depth == colour_depth(np.full((20, 30), 10.0 + number, np.float32))).all(), "a map keeps every bit"
    assert content["sides"][1] == {"source": "stereo", "kind": "depth", "name": "stereo: depth"}
    assert made.buttons == [], "a single prior needs no button"


def decoded(url: str) -> np.ndarray:
    data = np.frombuffer(base64.b64decode(url.split("base64,")[1]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]


@settings(max_examples=30, deadline=None)
@given(st.floats(1.0, 200.0))
def test_a_map_s_colours_read_back_as_what_they_mean(depth_m: float) -> None:
    """The legend's reading of a colour is the depth that it was drawn from, to the step between two colours (1.3 %)."""
    colour = hexadecimal(colour_depth(np.full((1, 1), depth_m, np.float32))[0, 0])
    reading = depth_legend().readings[colour]
    found = float(reading.split()[0])
    assert found == pytest.approx(np.clip(depth_m, 3, 80), rel=0.02)
    assert reading.endswith("or less") == (found == 3) and reading.endswith("or more") == (found == 80)
    truth_m = np.full((1, 1), 10.0, np.float32)
    error = error_legend().readings[hexadecimal(colour_error(truth_m * np.float32(1.03), truth_m)[0, 0])]
    assert error == "2 to 4 %"
    assert error_legend().readings[hexadecimal(colour_error(truth_m * 0, truth_m)[0, 0])] == "no value"


def test_pictures_are_shrunk_and_frames_left_out_until_they_fit() -> None:
    assert shown_size((375, 1242), 960) == (290, 960)
    assert shown_size((20, 30), 960) == (20, 30)
    first = wipe("a", frames=8)
    each = first.views[0].bytes
    both = fit_into([first, wipe("b", frames=2)], 10**9)
    assert [len(one.views) for one in both] == [8, 2]
    kept = fit_into([first], 4 * each + each // 2)[0].views
    assert len(kept) == 4 and kept[0].id == "a1", "spread evenly"
    assert [len(one.views) for one in fit_into([first, wipe("b")], 1)] == [1, 1], "one always stays"


NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn", "Co")), min_size=1, max_size=20)


@settings(max_examples=8, deadline=None)
@given(
    NAMES
    | st.sampled_from(
        ["<script>alert(1)</script>", '"onload="x', "a&amp;b", "{{ 7*7 }}", "$x$ _y", "]]>", "[/x]", "</script>"]
    )
)
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_are_text_and_never_markup(name: str) -> None:
    html = page(name).html()
    read = Reader(html)
    assert not read.open
    assert read.tags.count("script") == 2, "the page's own, and the pictures of its one wipe"
    assert f"priors eval {name}" in read.text.replace("\r", "")
    assert f"Of {name}" in read.text
    content = json.loads(re.search(r'application/json">(.*?)</script>', html, re.DOTALL)[1])  # type: ignore[index]
    assert content["sides"][1]["source"] == name


def test_the_same_page_has_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        page().write(tmp_path / "new" / name)
    first, second = ((tmp_path / "new" / name).read_bytes() for name in ("a.html", "b.html"))
    assert first == second == page().html().encode()
    assert len(list((tmp_path / "new").iterdir())) == 2


def scored(name: str, factor: float) -> Result:
    truth_m = np.linspace(2, 79, 400, dtype=np.float32).reshape(20, 20)
    frames = [(f"{i}", truth_m * np.float32(factor), None, truth_m) for i in range(2)]
    return score(frames, preset("paper"), info={"prior": name, "drive": "wall"})


def test_the_page_of_scores() -> None:
    results = [scored("good", 1.01), scored("bad", 1.2)]
    random = np.random.default_rng(0)
    samples = ScoredPixels(random.uniform(5, 50, 200), random.uniform(5, 50, 200), random.random(200))
    made = {"good": [curves(samples, "abs_rel"), curves(samples, "rmse")]}
    html = scores_page([DriveScores(results, made)], ("abs_rel", "rmse"), "priors eval cache", 10**6).html()
    read = Reader(html)
    assert not read.open
    assert "Depth priors of wall" in read.text
    assert html.count('<svg aria-hidden="true" xmlns') == 4
    for word in ("0.0100", "true distance, m (ranges 0-10, 10-20, 20-40, 40-80)", "farthest first", "RMSE, m"):
        assert word in read.text


def test_errors_by_distance_stand_at_the_ranges_middles() -> None:
    relative, metres = by_range([scored("bad", 1.2)])
    assert relative.lines[0].x.tolist() == metres.lines[0].x.tolist() == [5, 15, 30, 60]
    assert relative.lines[0].y[:3] == pytest.approx(0.2, abs=1e-6)  # the last range is clamped to 80 m
    assert (np.diff(metres.lines[0].y) > 0).all()


def test_sparsification_is_drawn_as_it_was_found() -> None:
    samples = ScoredPixels(np.array([10.0, 20, 30]), np.array([10.0, 25, 60]), np.array([0.9, 0.5, 0.1]))
    found = curves(samples, "rmse")
    (plot,) = sparsification("stereo", [found])
    assert (plot.title, plot.y_label) == ("stereo", "RMSE, m")
    assert [line.label for line in plot.lines] == ["by confidence", "farthest first", "oracle"]
    assert plot.lines[0].x == pytest.approx(100 * found.kept)
    assert plot.lines[0].y == pytest.approx(found.by_confidence)
    assert plot.lines[2].dashed


def test_importing_it_brings_neither_templates_nor_plots() -> None:
    code = (
        "import sys, priors.report.page, priors.report.scores\nassert not {'jinja2', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
