"""The shape of the code: functions that can be called without looking up what goes where."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST_PARAMETERS = 6


def sources() -> list[Path]:
    """Return our files outside the kernels: those are called by one function each, with arrays."""
    files = [path for top in ("eval", "priors", "nerf", "cli") for path in sorted((ROOT / top).rglob("*.py"))]
    return [path for path in files if "kernels" not in path.relative_to(ROOT).parts]


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Give each function of a file and how many parameters it has, without self."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            names = [argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            yield f"{path.relative_to(ROOT)}: {node.name}", len(names) - (names[:1] in (["self"], ["cls"]))


def test_no_function_has_more_parameters_than_one_remembers() -> None:
    many = {name for path in sources() for name, count in functions(path) if count > MOST_PARAMETERS}
    assert not many, f"more than {MOST_PARAMETERS} parameters: make some of them one thing"


def test_settings_are_found_by_their_names() -> None:
    """No door by name: what may be missing is a method of the base class, with a default."""
    doors = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources()
        if path.relative_to(ROOT).parts[:2] in (("priors", "methods"), ("priors", "pairs"))
        or path.name in ("build.py", "naming.py", "score.py", "filters.py", "check.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("hasattr", "getattr")
    ]
    assert not doors


def test_checks_are_not_assertions() -> None:
    """`python -O` drops assertions: what must hold is checked with a message, or said by a type."""
    rooms = ("priors/methods", "priors/pairs", "priors/nets", "priors/adapt", "priors/learn")
    rooms += ("priors/build", "priors/selection", "priors/score", "priors/check")
    left = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources()
        if str(path.relative_to(ROOT)).startswith(rooms)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Assert)
    ]
    assert not left


def test_names_are_taken_as_they_are() -> None:
    """Files are UTF-8 in any locale; square brackets of a name are no pattern and no markup."""
    wrong = {
        "text without encoding": re.compile(r"\.read_text\(\)|\.write_text\((?!.*encoding)|\.open\(\"[wa]\"\)"),
        "a pattern with a name in it that is not escaped": re.compile(
            r"glob\(f\"(?![^\"]*escape\()[^\"]*\{(?!manifest)[a-z]"
        ),
        "markup": re.compile(r"\[/?bold|\[/\]|(out|err|console)\.file\.write\("),
    }
    found = [
        f"{path.relative_to(ROOT)}:{number}: {what}"
        for path in sources()
        for number, line in enumerate(path.read_text().splitlines(), 1)
        for what, pattern in wrong.items()
        if pattern.search(line)
    ]
    assert not found
