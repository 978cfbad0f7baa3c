"""README, docs and --help agree with the code: their commands are run, or at least parsed."""

import ast
import functools
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import tyro

from cli import nerf, priors
from cli.priors import train

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
CARDS = sorted((ROOT / "priors" / "weights").glob("*.md"))
CODE = sorted(path for top in ("priors", "nerf", "eval", "cli") for path in (ROOT / top).rglob("*.py"))
PROGRAMS = {program.name: program for program in (priors.PROGRAM, nerf.PROGRAM)}
SMALLER = {
    "--frames 40": "--frames 10",  # one is held out
    "--frames 12": "--frames 4",
    "--size 1242x375": "--size 208x64",
    "--time 60s": "--time 2s",
}


def blocks(text: str) -> list[str]:
    """Return a page's indented and fenced blocks."""
    fenced = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return fenced + re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)


def commands(text: str) -> list[str]:
    """Return its `priors ...`, `nerf ...` and `python -m ...` lines, without what stands right of the command."""
    lines = [line.strip() for line in text.replace("\\\n", " ").splitlines()]
    ours = re.compile(r"(priors|nerf) [a-z]|python -m (priors|nerf|eval|cli)\.")
    return [re.split(r"\s{2,}|\s#", line)[0] for line in lines if ours.match(line)]


def docstring(path: Path) -> str:
    """Return a file's own docstring."""
    return ast.get_docstring(ast.parse(path.read_text())) or ""


def documented() -> list[str]:
    recipes = "architecture.md"  # its commands name files that tests/test_recipes.py writes, and runs them on
    texts = [page.read_text() for page in (*PAGES, *CARDS) if page.name != recipes] + [docstring(path) for path in CODE]
    found = [line for text in texts for block in blocks(text) for line in commands(block)]
    for program in PROGRAMS.values():
        found += commands(program.examples)
        for module in (f"cli.{program.name}.{command}" for command in program.commands):
            found += commands(import_module(module).EXAMPLES)
    return sorted(set(found))


class Parsed(Exception):
    """The arguments were understood."""


@pytest.mark.parametrize("line", documented())
def test_every_documented_command_is_understood(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program, name, *arguments = shlex.split(line)
    if program == "python":
        understand_module(*arguments, monkeypatch=monkeypatch)
        return
    module = import_module(f"cli.{program}.{name}")
    parse = module.parse

    def stop(*given: object) -> None:
        parse(*given)
        raise Parsed

    monkeypatch.setattr(module, "parse", stop)
    with pytest.raises(Parsed):
        module.run(arguments)


def understand_module(name: str, *arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a module that is a command of its own understand its arguments."""
    cli = tyro.cli

    def stop(what: Any, **more: Any) -> None:
        @functools.wraps(what)
        def parsed(*given: Any, **named: Any) -> None:
            raise Parsed

        cli(what if isinstance(what, type) else parsed, **more)
        raise Parsed

    monkeypatch.setattr(tyro, "cli", stop)
    with pytest.raises(Parsed):
        import_module(name).main(list(arguments))


def test_every_training_that_is_named_exists() -> None:
    texts = [page.read_text() for page in (*PAGES, *CARDS)] + [docstring(path) for path in CODE]
    names = {name for text in texts for name in re.findall(r"priors train ([a-z]+)", text)}
    assert len(names) >= 6
    for name in names:
        with pytest.raises(SystemExit) as caught:
            train.run([name, "--help"])
        assert caught.value.code == 0


def test_files_that_are_named_exist() -> None:
    """In documents and docstrings: priors/learn/loop.py, and learn/loop.py or loop.py beside the file that names it."""
    lost = []
    for path in (*PAGES, *CARDS, *CODE):
        text = path.read_text() if path.suffix == ".md" else docstring(path)
        for name in re.findall(
            r"(?<![\w./])((?:priors|nerf|eval|cli|learn|nets|kernels|adapt|methods)/[\w/]+\.py)\b", text
        ):
            if not any((top / name).exists() for top in (ROOT, ROOT / "priors", ROOT / "nerf")):
                lost.append(f"{path.relative_to(ROOT)}: {name}")
    assert not lost, "\n".join(lost)


@pytest.mark.docs
def test_the_readme_runs(tmp_path: Path) -> None:
    """Run the README's commands on the street in order, smaller."""
    lines = [
        line for block in blocks((ROOT / "README.md").read_text()) for line in commands(block) if "KITTI" not in line
    ]
    assert len(lines) >= 5
    for line in lines:
        for large, small in SMALLER.items():
            line = line.replace(large, small)
        if "KEY" in line:  # what the build before has printed
            line = re.sub(r"\S*-KEY", str(next((tmp_path / "cache").glob("*/stereo-*"))), line)
        program, *arguments = shlex.split(line)
        parts = [str(Path(sys.executable).parent / program), *arguments]
        done = subprocess.run(parts, cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_site_has_every_page() -> None:
    """zensical.toml: beside docs/ it shows the README, the changelog, how to contribute, and the networks' cards."""
    listed = re.findall(r'= "([\w/-]+\.md)"', (ROOT / "zensical.toml").read_text())
    pages = {str(page.relative_to(ROOT / "docs")) for page in PAGES if (ROOT / "docs") in page.parents}
    assert sorted(listed) == sorted(pages | {"index.md", "changelog.md", "contributing.md", "weights.md"})


def test_the_makefile_has_the_readme_s_targets() -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    used = re.findall(r"make ([a-z]+)", "\n".join(page.read_text() for page in PAGES[:2]))
    assert used
    assert set(used) <= set(targets)
