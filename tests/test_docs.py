"""README, docs and --help agree with the code: their commands are run, or at least parsed."""

import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from cli import nerf, priors

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROGRAMS = {program.name: program for program in (priors.PROGRAM, nerf.PROGRAM)}
SMALLER = {
    "--frames 40": "--frames 4",
    "--frames 12": "--frames 4",
    "--size 1242x375": "--size 320x96",
    "--time 60s": "--time 2s",
}


def blocks(page: Path) -> list[str]:
    """Return the page's indented and fenced blocks."""
    text = page.read_text()
    fenced = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return fenced + re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)


def commands(text: str) -> list[str]:
    """Return its `priors ...` and `nerf ...` lines, without comments and what stands right of the command."""
    lines = [line.strip() for line in text.replace("\\\n", " ").splitlines()]
    return [re.split(r"\s{2,}|\s#", line)[0] for line in lines if re.match(r"(priors|nerf) [a-z]", line)]


def documented() -> list[str]:
    recipes = "architecture.md"  # its commands name files that tests/test_recipes.py writes, and runs them on
    found = [line for page in PAGES if page.name != recipes for block in blocks(page) for line in commands(block)]
    for program in PROGRAMS.values():
        found += commands(program.examples)
        for module, _ in program.commands.values():
            found += commands(import_module(module).EXAMPLES)
    return sorted(set(found))


class Parsed(Exception):
    """The arguments were understood."""


@pytest.mark.parametrize("line", documented())
def test_every_documented_command_is_understood(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program, name, *arguments = shlex.split(line)
    module = import_module(PROGRAMS[program].commands[name][0])
    parse = module.parse

    def stop(*given: object) -> None:
        parse(*given)
        raise Parsed

    monkeypatch.setattr(module, "parse", stop)
    with pytest.raises(Parsed):
        module.run(arguments)


def test_the_readme_runs(tmp_path: Path) -> None:
    """Run the README's commands on the street in order, smaller."""
    lines = [line for block in blocks(ROOT / "README.md") for line in commands(block) if "KITTI" not in line]
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


def test_the_makefile_has_the_readme_s_targets() -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    used = re.findall(r"make ([a-z]+)", "\n".join(page.read_text() for page in PAGES[:2]))
    assert used
    assert set(used) <= set(targets)
