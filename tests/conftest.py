"""What the tests share: the real data beside the checkout, and tiny drives written into a temporary folder."""

import os
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import browser as browsers
import pytest
from factories import (
    write_argoverse_stereo,
    write_argoverse_tracking,
    write_as_folder,
    write_folder,
    write_odometry,
    write_raw,
)
from hypothesis import settings

from priors import drives, methods
from priors.drives import open_drive
from priors.machine import cpu
from priors.street.write import write_street

cpu.hold_down()  # before anything is compiled, as the commands do
settings.register_profile("repeated", derandomize=True, deadline=None)  # the same examples in every run
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeated"))

FLEET = Path(__file__).parent / "fleet"
SHARED = Path(__file__).resolve().parents[2] / "shared"
DATA = SHARED / "data"
RealData = Callable[..., Path]
"""The real_data fixture's type."""


def real(*parts: str) -> Path:
    """A folder of the real data, or skip with the reason."""
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no real data: {path} is missing")
    return path


@pytest.fixture
def real_data() -> RealData:
    """real_data("kitti_raw") -> its folder; skips where it is missing."""
    return real


@pytest.fixture
def raw_drive(tmp_path: Path) -> Path:
    """A tiny KITTI raw drive (factories.write_raw): its folder."""
    return write_raw(tmp_path / "raw")


@pytest.fixture
def odometry_root(tmp_path: Path) -> Path:
    """A tiny KITTI odometry root with sequence 06, complete (factories.write_odometry)."""
    return write_odometry(tmp_path / "odometry")


@pytest.fixture
def tracking_log(tmp_path: Path) -> Path:
    """A tiny Argoverse 1 tracking log (factories.write_argoverse_tracking): its folder."""
    return write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / "log-a")


@pytest.fixture
def stereo_log(tmp_path: Path) -> Path:
    """A tiny log of Argoverse 1's rectified stereo release with disparity maps: its folder."""
    return write_argoverse_stereo(tmp_path, "train", "log-a")


@pytest.fixture
def image_folder(tmp_path: Path) -> Path:
    """A tiny folder of images with calib.json (factories.write_folder)."""
    return write_folder(tmp_path / "mine")


@pytest.fixture(scope="session")
def browser() -> Iterator[browsers.Browser]:
    """This machine's Chromium (browser.py); skips where there is none."""
    with browsers.started() as running:
        yield running


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six small frames of the embedded street, written once: not to be changed."""
    out = tmp_path_factory.mktemp("street")
    write_street(out, 6, 7, (64, 208), workers=2)
    return out


@pytest.fixture
def street_folder(street: Path, tmp_path: Path) -> Path:
    """The same street as a folder of images with truth, sparse maps and poses: the test's own."""
    return write_as_folder(open_drive(street), tmp_path / "own")


@pytest.fixture
def own_street(street: Path, tmp_path: Path) -> Path:
    """The street that a file's tests share, copied: the test's own, to be damaged."""
    shutil.copytree(street, tmp_path / "street")
    return tmp_path / "street"


@pytest.fixture(scope="session")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, cache/ with a LiDAR prior, and runs/prior: three steps of `nerf fit` with it."""
    from nerf_commands import SIZE, nerf

    from priors import build
    from priors.methods.lidar import Lidar

    folder = tmp_path_factory.mktemp("home")
    write_street(folder / "street", 10, 7, SIZE)
    prior = build.prepare(open_drive(folder / "street"), Lidar(), folder=folder / "cache").run().prior
    run = folder / "runs" / "prior"
    assert nerf("fit", folder / "street", "--prior", prior.folder, "--steps", 3, "--run", run) == 0
    return folder


FullDisk = Callable[[int], AbstractContextManager[None]]
"""The full_disk fixture's type."""


@pytest.fixture
def full_disk() -> FullDisk:
    """with full_disk(100_000): files cannot grow beyond that many bytes, and writing more fails as on a full disk."""

    @contextmanager
    def full(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return full


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say on what kind of CPU the tests ran: what is green on one was wrong on another."""
    others = [mode for mode in cpu.supported() if mode != cpu.mode()]
    how = "all that this CPU has" if cpu.mode() == cpu.supported()[0] else f"held down by {cpu.VARIABLE}"
    if cpu.mode() == "amx_emulated":
        how = "the tiles' one product is emulated"
    terminalreporter.write_line(f"CPU mode {cpu.mode()}: {how}; `make modes` runs {', '.join(others)} here")


@pytest.fixture(scope="module")
def fleet_choices() -> Iterator[None]:
    """The methods and drives of tests/fleet are choices here, as ROADPRIOR_EXTENSIONS makes them elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROADPRIOR_EXTENSIONS", str(FLEET))
        patch.setenv("PYTHONPATH", str(FLEET.parents[1]))
        patch.setattr(methods, "__path__", [*methods.__path__, str(FLEET / "methods")])
        patch.setattr(drives, "__path__", [*drives.__path__, str(FLEET / "drives")])
        yield
