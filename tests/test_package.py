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
    assert {top for top in tops if not top.endswith(".dist-info")} == {"priors", "eval", "nerf", "cli"}


def test_the_wheel_holds_every_module(wheel_names: list[str]) -> None:
    modules = {
        str(p.relative_to(ROOT)) for top in ("priors", "eval", "nerf", "cli") for p in (ROOT / top).rglob("*.py")
    }
    assert modules <= set(wheel_names)


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


def test_nothing_needs_open3d() -> None:
    """The main path runs without the system libraries that open3d wants."""
    import_all("open3d onnxruntime matplotlib triton", "priors eval nerf cli")


def test_depth_maps_need_no_torch() -> None:
    """What needs no network works without torch, and no method imports it before a network is asked for."""
    import_all("open3d torch onnxruntime matplotlib", "priors eval", r"\.(nets|adapt|learn)\.|_(network|supervision)$")


def test_help_imports_no_compiler() -> None:
    """Numba costs half a second to import: no command's --help may pay it."""
    code = (
        "import sys\nfrom cli.priors import PROGRAM\n"
        "try: PROGRAM.run(['build', '--help'])\nexcept SystemExit: pass\n"
        "print([m for m in ('numba', 'scipy', 'embreex', 'torch') if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr.strip().splitlines()[-1] == "[]"
