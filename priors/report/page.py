"""A report page: one HTML file that loads nothing. Chapters hold sections, sections blocks (blocks.py, wipe.py).

Its style and scripts stand in the file; the only scripts that a browser runs are those two, by their hash. The same
content gives the same bytes.
"""

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

from eval.files import write_bytes

SUFFIX = ".html"
TEMPLATES = Path(__file__).parent / "templates"
SCRIPTS = ("table.js", "wipe.js")


class Block(Protocol):
    """What stands in a section: its template draws it, and finds it there as `block`."""

    template: ClassVar[str]
    """A file of templates/."""


@dataclass(frozen=True, slots=True)
class Section:
    """Blocks under one heading; a section without blocks is left out."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Chapter:
    """Sections that belong together: of a drive's priors, of its fields."""

    title: str
    lead: str
    """One paragraph: what was scored, against what."""
    sections: Sequence[Section]


@dataclass(frozen=True, slots=True)
class Page:
    """What a page says."""

    title: str
    lead: str
    """One paragraph."""
    chapters: Sequence[Chapter]
    command: str = ""
    """What made the page, as typed."""

    def html(self) -> str:
        """Return the page; its text is escaped, whatever a folder or a drive is called."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined  # here, so that --help is quick

        environment = Environment(
            loader=FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        script = "\n" + "".join(asset(name) for name in SCRIPTS)
        return environment.get_template("page.html.j2").render(
            page=self,
            chapters=[(chapter, _numbered(chapter, place)) for place, chapter in enumerate(self.chapters)],
            style=asset("style.css"),
            script=script,
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
            number=_Number(),
        )

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        write_bytes(path, self.html().encode())


class _Number:
    """Counts from 1: what makes the ids of a page different."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> int:
        self.count += 1
        return self.count


def asset(name: str) -> str:
    """Return the text of a file of templates/."""
    return (TEMPLATES / name).read_text("utf-8")


def data_url(data: bytes, media_type: str) -> str:
    """Return a file's bytes as an address that holds them."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode()}"


def _numbered(chapter: Chapter, place: int) -> list[tuple[str, Any]]:
    """Return the chapter's sections that are not empty, each after its anchor."""
    shown = [section for section in chapter.sections if section.blocks]
    return [(f"part-{place + 1}-{number}", section) for number, section in enumerate(shown, 1)]
