"""Docstrings and messages of the packages name flags and commands that exist."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli import logs
from cli.nerf import PROGRAM as NERF
from cli.owners import PROGRAMS, arguments_of
from cli.priors import PROGRAM as PRIORS
from cli.renamed import flags_of, negated

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("priors", "nerf", "eval", "cli")
FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9.-]*[a-z0-9])")
COMMAND = re.compile(r"`(priors|nerf) ([a-z]+)")
OTHERS = {
    "help",
    "version",
    logs.VERBOSE.strip("-"),
    logs.DEBUG.strip("-"),
    "nproc-per-node",
    "upgrade",
    "outer.inner",
    "no-name",
}
"""Flags of no command's dataclass: those of all commands, torchrun's, pip's, and stand-ins for any flag."""


def known() -> set[str]:
    kinds = [kind for program in PROGRAMS for kind in arguments_of(program).values()]
    names = {name for kind in kinds for name in flags_of(kind)}
    return names | {negated(name) for name in names} | OTHERS


def own_flags(tree: ast.Module) -> set[str]:
    """Flags of a file that is a program of its own: fields and arguments, one of which its tyro.cli may be given."""
    if "tyro.cli" not in ast.unparse(tree):
        return set()
    targets = (node.target for node in ast.walk(tree) if isinstance(node, ast.AnnAssign))
    fields = {target.id for target in targets if isinstance(target, ast.Name)}
    arguments = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    names = {name.replace("_", "-") for name in fields | arguments}
    for node in ast.walk(tree):  # the dataclass may be a neighbour's
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("priors.learn."):
            path = ROOT / f"{(node.module or '').replace('.', '/')}.py"
            names |= own_flags(ast.parse(path.read_text(encoding="utf-8")))
    return names


def docstrings(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value


def messages(tree: ast.Module) -> Iterator[str]:
    """The texts of all errors that a user reads, with a gap where a value goes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.endswith("Error"):
            for part in (part for given in node.args for part in ast.walk(given)):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.value


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_and_messages_name_flags_and_commands_that_exist(package: str) -> None:
    flags, commands = known(), {"priors": PRIORS.commands, "nerf": NERF.commands}
    wrong = []
    for file in sorted((ROOT / package).rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for text in (*docstrings(tree), *messages(tree)):
            text = re.sub(r"python tests/bench/.*", "", text)  # a script's flags are its own
            wrong += [f"{file}: --{flag}" for flag in FLAG.findall(text) if flag not in flags | own_flags(tree)]
            wrong += [f"{file}: {one} {two}" for one, two in COMMAND.findall(text) if two not in commands[one]]
    assert not wrong, "\n".join(wrong)
