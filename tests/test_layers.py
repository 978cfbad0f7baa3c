"""The layers of CONTRIBUTING.md: who may import whom."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {"eval": set(), "priors": {"eval"}, "nerf": {"priors", "eval"}, "cli": {"priors", "eval", "nerf"}}
OURS = set(MAY_IMPORT)
FILES = [path for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py"))]


def imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write it in full"
            names.add(node.module or "")
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_down(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    found = {name.split(".")[0] for name in imports(path)} & OURS - {package}
    assert found <= MAY_IMPORT[package]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_eval_is_imported_by_its_files(path: Path) -> None:
    """`import eval` would hide the builtin and take any eval.py that is first on the path."""
    tree = ast.parse(path.read_text())
    plain = [alias for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    assert all(alias.name != "eval" or alias.asname for alias in plain)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_one_noun(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400
