"""Help and documents agree with the commands: every example names commands and flags that there are."""

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from cli.owners import PROGRAMS, arguments_of
from cli.renamed import flags_of, negated

ROOT = Path(__file__).resolve().parents[1]
KINDS: dict[str, type[Any]] = {name: kind for program in PROGRAMS for name, kind in arguments_of(program).items()}
RECIPES = {"road.height-m"}
"""Flags of the methods that docs/architecture.md writes; tests/test_recipes.py runs them."""
COMMANDS = sorted({" ".join(name.split()[:2]) for name in KINDS})
TYPED = re.compile(r"^\s*(?:\$ |OMP\S+ |flock \S+ )?((?:priors|nerf) [a-z][^#`]*)")
FLAG = re.compile(r"(?<![\w-])--([a-z][\w.-]*)")


def examples_of(command: str) -> str:
    program, name = command.split()
    text: str = import_module(f"cli.{program}.{name}").EXAMPLES
    return text


def typed_in(text: str) -> Iterator[str]:
    """Yield the commands that a text shows, one a line; what follows two spaces says what they do."""
    for line in text.splitlines():
        if (found := TYPED.match(line)) is not None:
            yield re.split(r" {2,}", found[1].strip())[0]


def unknown(typed: str) -> str:
    """Return the command or the first flag of a line that there is not; nothing where all are there."""
    words = typed.split()
    name = next((" ".join(words[:n]) for n in (3, 2) if " ".join(words[:n]) in KINDS), "")
    if not name:
        return "" if words[:2] == ["priors", "train"] else " ".join(words[:2])
    flags = {"help", *flags_of(KINDS[name])}
    known = flags | {negated(flag) for flag in flags} | RECIPES
    return next((f"--{flag}" for flag in FLAG.findall(typed) if flag not in known), "")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_begins_with_examples(command: str) -> None:
    what, _, examples = examples_of(command).partition("\n\nexamples:\n")
    assert what and "\n\n" not in what, "what it does, in a few lines"
    shown = list(typed_in(examples))
    assert shown and f"{shown[0]} ".startswith(f"{command} ")
    assert [unknown(line) for line in shown if unknown(line)] == []


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_s_examples_can_be_typed(program: str) -> None:
    shown = list(typed_in(import_module(f"cli.{program}").PROGRAM.examples))
    assert len(shown) > 5
    assert [line for line in shown if unknown(line)] == []


@pytest.mark.parametrize("page", sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")]), ids=lambda page: page.name)
def test_what_a_document_shows_can_be_typed(page: Path) -> None:
    blocks = (line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith(("    ", "$ ")))
    wrong = [(line, unknown(line)) for line in typed_in("\n".join(blocks)) if unknown(line)]
    assert wrong == []


def test_what_cannot_be_typed_is_found() -> None:
    assert unknown("priors build street/ --no-such 3") == "--no-such"
    assert unknown("priors bild street/") == "priors bild"
    assert unknown("priors train stereo runs/a --minutes 3") == unknown("nerf fit --no-truth-mask") == ""
