"""A report page: one HTML file with tables, plots (inline SVG), pictures (inline JPEG) and the commands that made them.

It loads nothing: no script, no font, no other file. `page.html.j2` beside this file is its template (Jinja2).
"""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eval.files import write_bytes
from eval.typeset import Table
from priors import codecs
from priors.draw import lines
from priors.draw.lines import Plot
from priors.types import Image

SUFFIX = ".html"
TEMPLATE = "page.html.j2"
PICTURED = 4
"""Frames that a page has pictures of, where there are many."""
JPEG_QUALITY = 82
"""A comparison of 1240 px is then about 150 kB."""


@dataclass(frozen=True, slots=True)
class Figure:
    """Plots that stand together."""

    plots: Sequence[Plot]
    columns: int = 1
    caption: str = ""

    def svg(self) -> str:
        """Return the drawing as an <svg> element."""
        return element(lines.svg(self.plots, self.columns))


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture with its caption, which is also what a screen reader says."""

    caption: str
    image: Image
    """(height, width, 3) RGB."""

    def url(self) -> str:
        """Return the picture as a data URL."""
        data = codecs.encode_image(Path(f"{self.caption}.jpg"), self.image, JPEG_QUALITY)
        return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page under one heading; what is empty is left out."""

    title: str
    text: str = ""
    table: Table | None = None
    figures: Sequence[Figure] = ()
    pictures: Sequence[Picture] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    """Names and values, a line each."""
    commands: Sequence[str] = ()
    """As typed."""

    @property
    def empty(self) -> bool:
        """Whether there is nothing under the heading."""
        return not (self.text or self.table or self.figures or self.pictures or self.facts or self.commands)


@dataclass(frozen=True, slots=True)
class Page:
    """What a page says."""

    title: str
    lead: str
    """One paragraph: what was scored, against what."""
    sections: Sequence[Section]

    def html(self) -> str:
        """Return the page; its text is escaped, whatever a folder or a drive is called."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined  # here, so that --help is quick

        environment = Environment(
            loader=FileSystemLoader(Path(__file__).parent),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        shown = [section for section in self.sections if not section.empty]
        drawn = _number_ids([[figure.svg() for figure in section.figures] for section in shown])
        return environment.get_template(TEMPLATE).render(page=self, sections=zip(shown, drawn, strict=True))

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        write_bytes(path, self.html().encode())


def element(svg: str) -> str:
    """Return the <svg> element of an SVG file, without the file's declarations."""
    return svg[svg.index("<svg") :].strip()


def _number_ids(drawn: Sequence[Sequence[str]]) -> list[list[str]]:
    """Make the ids of all drawings different: a page may hold each id once."""
    count = 0
    numbered: list[list[str]] = []
    for drawings in drawn:
        numbered.append([])
        for svg in drawings:
            count += 1
            numbered[-1].append(re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>s{count}-", svg))
    return numbered
