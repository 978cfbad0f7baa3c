"""Compiled kernels: where they are kept, and what the commands say while they are made."""

import io
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.progress import Progress

from cli.compiling import CompilingColumn, Watch
from cli.terminal import Screen
from priors.machine import notices
from priors.machine.pruning import prune

ROOT = Path(__file__).resolve().parents[1]
SMALL = """
from priors.machine.compiled import compiled, kept_in
from priors.machine.notices import on_compile, on_compiled
from small import twice
told = []
on_compile.append(lambda name: told.append(f"begin {name}"))
on_compiled.append(lambda name: told.append(f"end {name}"))
assert twice(3) == 6
print(kept_in(), *told, sep=";")
"""
MODULE = """
from priors.machine.compiled import compiled

@compiled
def once(x):
    return x

@compiled
def twice(x):
    return once(x) + once(x)
"""
COMPILED = "begin twice;begin once;end once;end twice"


def run(
    folder: Path, root: Path = ROOT, path: tuple[Path, ...] = (), **variables: str | None
) -> subprocess.CompletedProcess[str]:
    """Compile a small function in a process of its own; a variable of None is not set there."""
    folder.mkdir(exist_ok=True)
    (folder / "small.py").write_text(MODULE)
    given = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (folder, root, *path))), **variables}
    environment = {name: value for name, value in given.items() if value is not None}
    command = [sys.executable, "-P", "-c", SMALL]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def test_kernels_of_earlier_sources_are_pruned(tmp_path: Path) -> None:
    for days in range(8):
        folder = tmp_path / f"avx2-{days:012x}"
        (folder / "deep").mkdir(parents=True)
        os.utime(folder, (time.time() - days * 3 * 86400,) * 2)
    other = tmp_path / "notes"
    other.mkdir()
    os.utime(other, (0, 0))
    prune(tmp_path)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == [*(f"avx2-{days:012x}" for days in range(4)), "notes"], "the last four; two of them are old"
    for days in range(4):
        os.utime(tmp_path / f"avx2-{days:012x}")
    (tmp_path / f"plain-{9:012x}").mkdir()
    prune(tmp_path)
    assert len(list(tmp_path.iterdir())) == 6, "five, all in use"
    prune(tmp_path / "nowhere")


def test_a_kernel_is_compiled_once_and_then_kept(tmp_path: Path) -> None:
    cache = tmp_path / "kept"
    first, second = (run(tmp_path / "code", ROADPRIOR_CACHE=str(cache)).stdout.strip() for _ in range(2))
    assert first == f"{cache};{COMPILED}"
    assert second == str(cache)


def test_the_users_cache_folder_is_the_default(tmp_path: Path) -> None:
    told = run(tmp_path / "code", ROADPRIOR_CACHE=None, XDG_CACHE_HOME=None, HOME=str(tmp_path)).stdout
    assert told.startswith(f"{tmp_path / '.cache' / 'roadprior' / 'kernels'};")
    told = run(tmp_path / "code", ROADPRIOR_CACHE=None, XDG_CACHE_HOME=str(tmp_path / "mine")).stdout
    assert told.startswith(f"{tmp_path / 'mine' / 'roadprior' / 'kernels'};")


def test_no_home_and_no_writable_cache_folder_end_in_the_temporary_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")  # a folder cannot be made below it, not even by root
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    # Without HOME Python asks the password file; /proc is where nobody can write.
    for home in (None, str(tmp_path / "file"), "/proc"):
        given = {"ROADPRIOR_CACHE": None, "HOME": home, "TMPDIR": str(temporary)}
        told = run(tmp_path / "code", XDG_CACHE_HOME=None if home is None else f"{home}/cache", **given)
        assert told.returncode == 0, told.stderr
        assert home is None or told.stdout.startswith(f"{temporary}/roadprior-kernels-")


def test_a_cache_that_cannot_be_written_is_no_obstacle_and_compiling_is_still_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    told = run(tmp_path / "code", ROADPRIOR_CACHE=str(tmp_path / "file" / "below"))
    assert told.stdout.strip() == f"None;{COMPILED}", told.stderr


def test_an_install_that_cannot_be_written_is_no_obstacle(tmp_path: Path) -> None:
    install = tmp_path / "install"
    ignored = shutil.ignore_patterns("__pycache__", "weights")
    shutil.copytree(ROOT / "priors", install / "priors", ignore=ignored)
    for path in [install, *install.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        before = sorted(install.rglob("*"))
        told = run(tmp_path / "code", install, ROADPRIOR_CACHE=str(tmp_path / "kept"), PYTHONDONTWRITEBYTECODE="1")
        assert told.stdout.strip() == f"{tmp_path / 'kept'};{COMPILED}", told.stderr
        assert sorted(install.rglob("*")) == before
    finally:
        for path in [install, *install.rglob("*")]:
            path.chmod(0o755)


def build(drive: Path, cache: Path, kept: Path) -> str:
    command = [sys.executable, "-c", "from cli.priors import main; main()", "build", str(drive), "--method", "lidar"]
    environment = {**os.environ, "ROADPRIOR_CACHE": str(kept)}
    done = subprocess.run(
        [*command, "--cache", str(cache)], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_a_command_says_once_that_it_compiles_and_nothing_where_all_is_kept(tmp_path: Path, raw_drive: Path) -> None:
    first = build(raw_drive, tmp_path / "a", tmp_path / "kept").splitlines()
    assert first.count(f"compiling kernels for this CPU, once (kept in {tmp_path / 'kept'})") == 1
    assert len([line for line in first if line.startswith("compiled ") and " functions in " in line]) == 1
    second = build(raw_drive, tmp_path / "b", tmp_path / "kept")
    assert "compil" not in second


@pytest.fixture
def watched() -> Iterator[tuple[Watch, io.StringIO, Screen]]:
    """A watch that is told what the test tells it, and what it prints on a terminal."""
    text = io.StringIO()
    console = Screen(file=text, force_terminal=True, width=200, color_system=None)
    watch = Watch(console)
    before = list(notices.on_compile), list(notices.on_compiled)
    watch.install()
    watch.install()  # once is enough
    yield watch, text, console
    watch.finish()
    notices.on_compile[:], notices.on_compiled[:] = before


def tell(listeners: list, name: str) -> None:  # type: ignore[type-arg]
    for listener in listeners:
        listener(name)


def test_nested_functions_count_and_are_one_burst(watched: tuple[Watch, io.StringIO, Screen]) -> None:
    watch, text, _ = watched
    tell(notices.on_compile, "outer")
    tell(notices.on_compile, "inner")
    tell(notices.on_compiled, "inner")
    assert watch.text().startswith("compiling kernels: 1 done, ")
    tell(notices.on_compiled, "outer")
    assert watch.text() == ""
    watch.finish()
    watch.finish()
    assert text.getvalue().count("compiled 2 functions in 0 s") == 1
    tell(notices.on_compile, "late")
    tell(notices.on_compiled, "late")
    watch.finish()  # short: not worth a line
    assert text.getvalue().count("compiled") == 1
    assert text.getvalue().count("for this CPU") == 1


def test_a_bar_that_runs_shows_what_is_compiled(watched: tuple[Watch, io.StringIO, Screen]) -> None:
    watch, text, console = watched
    watch.bar_begins()
    with Progress(CompilingColumn(watch), console=console) as bar:
        bar.add_task("frames", total=1)
        tell(notices.on_compile, "kernel")
        bar.refresh()
        tell(notices.on_compiled, "kernel")
    watch.bar_ends()
    assert "compiling kernels: 0 done, 0 s" in text.getvalue()


def test_a_bar_may_begin_while_something_is_compiled(watched: tuple[Watch, io.StringIO, Screen]) -> None:
    watch, text, console = watched
    tell(notices.on_compile, "kernel")
    time.sleep(0.2)
    assert "compiling kernels: 0 done" in text.getvalue()
    watch.bar_begins()
    with Progress(console=console):  # two moving lines would raise
        tell(notices.on_compiled, "kernel")
    watch.bar_ends()
