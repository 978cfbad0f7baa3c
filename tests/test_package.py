"""What is installed: the wheel holds our packages and nothing else, and the light parts stay light."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        return wheel.namelist()


def test_the_wheel_holds_our_packages_only(wheel_names: list[str]) -> None:
    tops = {name.split("/")[0] for name in wheel_names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"priors", "eval", "cli"}


def test_the_wheel_holds_every_module(wheel_names: list[str]) -> None:
    modules = {str(p.relative_to(ROOT)) for top in ("priors", "eval", "cli") for p in (ROOT / top).rglob("*.py")}
    assert modules <= set(wheel_names)


def test_nothing_needs_open3d_or_torch() -> None:
    """Import every module with the heavy packages barred: the main path runs without their system libraries."""
    code = (
        "import sys, pkgutil, importlib\n"
        "for name in ('open3d', 'torch', 'onnxruntime', 'matplotlib'): sys.modules[name] = None\n"
        "import priors, eval, cli\n"
        "for package in (priors, eval, cli):\n"
        "    for module in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):\n"
        "        importlib.import_module(module.name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_help_imports_no_compiler() -> None:
    """Numba costs half a second to import: no command's --help may pay it."""
    code = (
        "import sys\nfrom cli.priors import run\n"
        "try: run(['build', '--help'])\nexcept SystemExit: pass\n"
        "print([m for m in ('numba', 'scipy', 'embreex') if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr.strip().splitlines()[-1] == "[]"
