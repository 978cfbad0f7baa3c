"""What is installed: the wheel holds our packages and nothing else, and the light parts stay light."""

import json
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest

from cli import nerf, priors
from cli.program import Program

LAZY = "onnxruntime onnx skimage matplotlib jinja2 av viser"
"""Packages that are imported where they are used."""
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def wheel_names(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_the_wheel_holds_our_packages_only(wheel_names: list[str]) -> None:
    tops = {name.split("/")[0] for name in wheel_names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"priors", "eval", "nerf", "cli"}


def test_the_wheel_holds_every_module(wheel_names: list[str]) -> None:
    modules = {
        str(p.relative_to(ROOT)) for top in ("priors", "eval", "nerf", "cli") for p in (ROOT / top).rglob("*.py")
    }
    assert modules <= set(wheel_names)


def test_the_wheel_writes_a_report_page(wheel: Path, tmp_path: Path) -> None:
    """The page's template is no module: it must be in the wheel, and found there."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = (
        "import priors.report.page as page, pathlib, sys\n"
        "assert page.__file__.startswith(sys.argv[1]), page.__file__\n"
        "page.Page('A title', '', []).write(pathlib.Path('a.html'))\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, cwd=tmp_path)
    assert "<h1>A title</h1>" in (tmp_path / "a.html").read_text()


def import_all(barred: str, packages: str, beside: str = "triton") -> None:
    """Import every module of packages with others barred, but those that `beside` (a regular expression) matches."""
    code = (
        "import sys, pkgutil, importlib, re\n"
        f"for name in {barred.split()}: sys.modules[name] = None\n"
        f"for name in {packages.split()}:\n"
        "    package = importlib.import_module(name)\n"
        "    for module in pkgutil.walk_packages(package.__path__, name + '.'):\n"
        f"        if not re.search({beside!r}, module.name): importlib.import_module(module.name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_heavy_packages_are_imported_where_they_are_used() -> None:
    """No module needs them to be imported: open3d wants system libraries, the others are for some commands only."""
    import_all("open3d triton " + LAZY, "priors eval nerf cli")


def test_depth_maps_need_no_torch() -> None:
    """What needs no network works without torch, and no method imports it before a network is asked for."""
    import_all("open3d torch " + LAZY, "priors eval", r"\.(nets|adapt|learn|stress)\.|_(network|supervision)$")


def imported_by_help(program: str, commands: Iterable[str]) -> dict[str, set[str]]:
    """Return the packages that are imported once each command's --help was asked for, one after the other."""
    code = (
        f"import sys, json\nfrom cli.{program} import PROGRAM\n"
        f"for command in {[*commands]!r}:\n"
        "    try: PROGRAM.run([command, '--help'])\n"
        "    except SystemExit: pass\n"
        "    print(json.dumps([command, *{name.split('.')[0] for name in sys.modules}]), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True)
    told = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("[")]
    return {command: set(packages) for command, *packages in told}


def test_help_imports_no_compiler() -> None:
    """Numba costs half a second to import, torch more: the --help of the usual commands may not pay it."""
    usual = ("build", "eval", "show")
    found = imported_by_help("priors", usual)
    assert [{"numba", "scipy", "embreex", "torch"} & found[command] for command in usual] == [set(), set(), set()]


@pytest.mark.parametrize("program", [priors.PROGRAM, nerf.PROGRAM], ids=["priors", "nerf"])
def test_help_imports_nothing_that_only_results_need(program: Program) -> None:
    found = imported_by_help(program.name, program.commands)
    heavy = {command: {*LAZY.split(), "open3d"} & packages for command, packages in found.items()}
    assert heavy == {command: set() for command in program.commands}
