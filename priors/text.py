"""Text files as people's programs leave them: the one reader of text, lines and JSON that users bring.

Editors on Windows put a byte order mark first, write UTF-16, end lines by \\r\\n (copies make \\r\\r\\n of it), and
save an umlaut in a comment as one byte. None of that changes a number.
"""

import codecs
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from priors.errors import DataError, unreadable

MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Byte order mark -> encoding, which skips the mark."""
LINE_END = re.compile(r"\r*\n|\r")
COMMENT = re.compile(r"(^|\s)#.*")


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a file."""

    number: int
    """As an editor counts: from 1."""
    text: str
    """Without comment, and without blanks around it; empty where there is nothing else."""

    @property
    def words(self) -> list[str]:
        """What stands between blanks."""
        return self.text.split()


def read_text(path: Path, lost: str = "") -> str:
    """Read a small text file, its lines ended by \\n.

    A byte that is no UTF-8 is read as Latin-1: names and numbers are ASCII and the same in both. `lost` says what to do
    where there is no such file.

    Raises:
        DataError: it is missing, cannot be read, or is no text.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error, lost) from error
    for encoding in _encodings(data):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return LINE_END.sub("\n", text.lstrip("\ufeff"))
    raise DataError(f"{path}: is not text: write it again as plain UTF-8")


def read_lines(path: Path, lost: str = "") -> list[Line]:
    """Read a text file's lines; those that hold nothing but a comment are left out, empty ones are kept.

    A comment begins with # at the line's start or behind a blank. `lost` says what to do where there is no such file.
    """
    lines = []
    for number, text in enumerate(read_text(path, lost).removesuffix("\n").split("\n"), 1):
        bare = COMMENT.sub("", text).strip()
        if bare or not text.strip():
            lines.append(Line(number, bare))
    return lines


def read_json(path: Path, lost: str = "") -> dict[str, Any]:
    """Read a JSON object; DataError where it is missing, which `lost` mends, damaged or not an object."""
    try:
        data = json.loads(read_text(path, lost))
    except (json.JSONDecodeError, RecursionError) as error:
        raise DataError(f"{path}: damaged JSON ({error}): download or write it again") from error
    if not isinstance(data, dict):
        raise DataError(f"{path}: expected a JSON object, found {type(data).__name__}")
    return data


def _encodings(data: bytes) -> tuple[str, ...]:
    """Return the encodings to try: what the byte order mark says, else UTF-16 by its zero bytes, else UTF-8."""
    for mark, encoding in MARKS.items():
        if data.startswith(mark):
            return (encoding,) if encoding != "utf-8-sig" else (encoding, "latin-1")
    if b"\0" in data[:2]:  # the first letter is ASCII: its other byte is zero
        return ("utf-16-be",) if data[0] == 0 else ("utf-16-le",)
    return ("utf-8", "latin-1")
