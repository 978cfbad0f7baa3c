"""Replacements for characters that a terminal's encoding lacks (cp1252, ASCII), so that printing never fails."""

import codecs
import io
import unicodedata
from typing import TextIO

NAME = "roadprior-stand-ins"
"""The error handler's name."""
STAND_INS = {
    "↑": "^", "↓": "v", "→": ">", "←": "<", "δ": "d", "²": "2", "³": "3", "×": "x", "·": "*", "…": ".",
    "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "≤": "<", "≥": ">", "±": "~", "°": "o",
    "µ": "u", "μ": "u", "σ": "s", "λ": "l", "│": "|", "━": "-", "─": "-", "█": "#", "•": "*",
}  # fmt: skip
"""One character each, so that columns stay in line."""


def say_plainly(streams: tuple[TextIO | None, ...]) -> None:
    """Let streams of the process write stand-ins where they would fail."""
    codecs.register_error(NAME, _replace)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):  # None where it was closed before the start
            stream.reconfigure(errors=NAME)


def stand_in(character: str) -> str:
    """Return what is written for a character, in ASCII: a look-alike, the letter below its accents, or its code."""
    if "\udc80" <= character <= "\udcff":  # a byte of a file's name that is no UTF-8
        return f"\\x{ord(character) - 0xDC00:02x}"
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return STAND_INS.get(character) or plain or character.encode("ascii", "backslashreplace").decode()


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(stand_in, error.object[error.start : error.end])), error.end
