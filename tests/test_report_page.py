"""The report page: well-formed, self-contained, and safe whatever things are called."""

import base64
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.curves import ScoredPixels, curves
from eval.protocol import preset
from eval.result import Result, score
from eval.typeset import Column, lay_out
from priors.draw.lines import Line, Plot
from priors.report.page import Figure, Page, Picture, Section
from priors.report.scores import by_range, scores_page, sparsification

VOID = {"meta", "img", "br", "hr", "link"}
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


def page(name: str = "a", **more: Any) -> Page:
    plots = [Plot([Line(name, X, X**2)], "x, m", "y, dB", name)]
    rows = [((name,), {"psnr": 20.0}), (("b",), {"psnr": 21.0}), (("c",), {})]
    sections = [
        Section(
            "Figures",
            table=lay_out(("run",), {"psnr": Column("PSNR", "dB", higher=True, digits=2)}, rows, name, [name]),
        ),
        Section("Plots", figures=[Figure(plots, caption=name), Figure(plots)]),
        Section("Pictures", pictures=[Picture(name, np.full((20, 30, 3), 200, np.uint8))]),
        Section("Settings", facts={name: name}),
        Section("Nothing"),
        Section("Commands", commands=[f"priors eval {name}"]),
    ]
    return Page(f"Of {name}", name, sections, **more)


def test_a_page_is_whole_and_loads_nothing() -> None:
    read = Reader(page().html())
    assert not read.open
    assert len(read.ids) == len(set(read.ids)) > 10
    for link in read.links:
        if "#" in link:
            assert link.split("#")[1].rstrip(")") in read.ids, "what a drawing refers to is in the page"
        else:
            assert link.startswith("data:image/jpeg;base64,")
    assert not {"script", "link", "iframe", "object"} & set(read.tags)
    assert read.text.count("Nothing") == 0, "an empty section has no heading"


def test_a_page_says_what_it_was_given() -> None:
    html = page().html()
    assert '<td class="figure bold">21.00</td>' in html
    assert '<td class="figure underline">20.00</td>' in html
    assert html.count("<svg") == 2
    assert "priors eval a</pre>" in html
    data = html.split("base64,")[1].split('"')[0]
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (20, 30, 3)
    assert np.abs(picture.astype(int) - 200).max() < 3
    assert len(html) < 60_000


NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn", "Co")), min_size=1, max_size=20)


@settings(max_examples=8, deadline=None)
@given(NAMES | st.sampled_from(["<script>alert(1)</script>", '"onload="x', "a&amp;b", "{{ 7*7 }}", "$x$ _y", "]]>"]))
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_are_text_and_never_markup(name: str) -> None:
    read = Reader(page(name).html())
    assert not read.open
    assert "script" not in read.tags
    assert f"priors eval {name}" in read.text.replace("\r", "")
    assert f"Of {name}" in read.text


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
    html = scores_page(results, ("abs_rel", "rmse"), made, [], "priors eval cache").html()
    read = Reader(html)
    assert not read.open
    assert "Depth priors of wall" in read.text
    assert html.count("<svg") == 2
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
