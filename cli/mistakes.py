"""Mistyped arguments: one line says what is wrong and which flag or value comes nearest."""

import io
import re
from collections.abc import Sequence
from contextlib import redirect_stderr
from difflib import get_close_matches
from typing import TypeVar

import tyro

from cli import owners
from cli.renamed import flags_of, negated
from priors.errors import DataError, UsageError

Parsed = TypeVar("Parsed")
NEAR = 0.6
"""Words as alike as this (difflib's ratio) may be the same word mistyped."""
VERY_NEAR = 0.8
"""Words as alike as this are the same word mistyped, even where another command has the mistyped one."""


def nearest(word: str, words: Sequence[str]) -> str:
    """Return ': did you mean X?' for the nearest of some words; nothing where none is near."""
    near = get_close_matches(word, words, 1, NEAR)
    return f": did you mean {near[0]}?" if near else ""


def refuse_unknown(kind: type[object], command: str, arguments: Sequence[str]) -> None:
    """Raise UsageError at the first flag that a command does not have; it says which flag, or command, is meant."""
    names = flags_of(kind)
    flags = {f"--{name}" for name in names} | {"--help"}
    known = flags | {f"--{negated(name)}" for name in names}
    for word in arguments:
        flag = word.partition("=")[0].replace("_", "-")
        if word.startswith("--") and len(word) > 2 and flag not in known:
            hint = _hint(flag, sorted(flags), command, arguments)
            raise UsageError(f"{command} has no flag {word.partition('=')[0]}{hint}")


def _hint(flag: str, flags: Sequence[str], command: str, arguments: Sequence[str]) -> str:
    """Say what is meant by an unknown flag: one of a group, one mistyped, or one of another command."""
    inner = [other for other in flags if other.endswith(f".{flag.removeprefix('--')}")]
    asked = [other for other in inner if other.removeprefix("--").partition(".")[0] in arguments]
    if inner:
        return f": did you mean {' or '.join(asked or inner)}?"
    if get_close_matches(flag, flags, 1, VERY_NEAR):
        return nearest(flag, flags)
    return owners.told(owners.commands_with(flag, command)) or nearest(flag, flags) or f": see {command} --help"


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Raise UsageError at an empty word: as a path it would be the current folder (--cache "$UNSET")."""
    for before, word in zip(("", *arguments), arguments, strict=False):
        flag, equals, value = word.partition("=")
        if not word or (equals and flag.startswith("--") and not value):
            where = flag or (before if before.startswith("--") else "")
            raise UsageError(f"{where} '': expected something, found nothing: is a variable unset?".strip())


def parse(kind: type[Parsed], command: str, examples: str, arguments: Sequence[str]) -> Parsed:
    """Make a command's dataclass of its arguments; UsageError, one line, where they are wrong."""
    refuse_unknown(kind, command, arguments)
    _refuse_empty(arguments)
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(kind, prog=command, description=examples, args=arguments)
    except DataError as error:  # a config refused what it was made of
        raise UsageError(str(error)) from error
    except SystemExit as leaving:
        if not leaving.code:
            raise
        raise UsageError(_one_line(said.getvalue(), command)) from leaving


def _one_line(box: str, command: str) -> str:
    """Turn the parser's box of several lines into one line."""
    lines = [re.sub(r"^[│|] ?|\s*[│|]$", "", line).strip() for line in box.splitlines()]
    words = []
    for line in lines:
        if line.startswith("For full helptext"):
            break
        if line and not set(line) <= set("─╭╮╰╯━-+= ") and line[0] not in "╭╰+":
            words.append(line)
    text = " ".join(words).replace(f"Missing from {command}:", "missing:").replace(" (required)", "")
    text = text.partition(" Argument helptext:")[0]
    choice = re.search(r"invalid choice '(.*)' for argument '(--\S+)'\. Expected one of \((.*)\)\.", text)
    if choice is not None:
        wrong, flag, listed = choice.groups()
        choices = sorted({part.strip(" '") for part in listed.split(",")} - {"", "None"})  # they come in any order
        return f"{flag} {wrong}: choose one of {', '.join(choices)}{nearest(wrong, choices)}"
    return f"{text[:1].lower() + text[1:].rstrip('.')}: see {command} --help"
