"""`priors view` and `nerf view` in a real browser: they draw, their controls change it, Ctrl-C ends them in a line."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, Window

from nerf.config import FitConfig, ModelConfig
from nerf.prepare import SceneConfig
from nerf.run import begin
from priors import build
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.street.write import write_street

pytestmark = pytest.mark.browser
COMMANDS = Path(sys.executable).parent


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home")
    write_street(folder / "street", 4, 7, (96, 320))
    drive = open_drive(folder / "street")
    prior = build.prepare(drive, Lidar(), folder=folder / "cache").run().prior
    fit = FitConfig(ModelConfig(log2_size=14), steps=60)
    begin(drive, prior, SceneConfig(), fit, folder / "runs" / "a").fit()
    return folder


@contextmanager
def served(*arguments: object, cwd: Path) -> Iterator[str]:
    """Run a view; yields its address. Ctrl-C must end it, with one line."""
    command = [str(COMMANDS / str(arguments[0])), *map(str, arguments[1:])]
    # A shell starts background jobs with Ctrl-C ignored, and what they start inherits it; on a terminal it is not.
    running = subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, text=True, preexec_fn=_hear_ctrl_c)
    assert running.stdout is not None
    try:
        line = running.stdout.readline()
        found = re.fullmatch(r"open (http://\S+) in a browser; Ctrl-C ends the view\n", line)
        assert found, line
        yield found[1]
        running.send_signal(signal.SIGINT)
        assert running.communicate(timeout=30)[0] == "the view has ended\n" and running.returncode == 0
    finally:
        running.kill()


def _hear_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def scene_picture(window: Window) -> np.ndarray:
    """The 3D part of the window, left of the controls and below viser's notices."""
    return window.picture()[300:800, :1000].astype(float)


def until(window: Window, holds: Callable[[], bool], seconds: float = 30) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline, "not seen in time"
        window.page.wait_for_timeout(200)


def changed(window: Window, before: np.ndarray) -> Callable[[], bool]:
    return lambda: np.abs(scene_picture(window) - before).mean() > 0.3


@pytest.mark.parametrize("what", ["cache", "street"])
def test_points_are_drawn_and_the_slider_changes_them(browser: Browser, home: Path, what: str) -> None:
    with served("priors", "view", what, cwd=home) as address, browser.open(address) as window:
        until(window, lambda: scene_picture(window).std() > 5)
        window.page.get_by_text("frame 0000000000, 1 of 4").wait_for()
        before = scene_picture(window)
        slider = window.page.get_by_role("slider").first
        slider.focus()
        slider.press("ArrowRight")
        window.page.get_by_text("frame 0000000001, 2 of 4").wait_for()
        until(window, changed(window, before))
        window.page.mouse.click(400, 850)
        window.page.keyboard.press("b")
        window.page.get_by_text("frame 0000000000, 1 of 4").wait_for()
        window.page.get_by_text("stand where this frame's camera was").click()
        until(window, lambda: scene_picture(window).std() > 5)
        assert not window.errors and not window.left


def test_a_field_follows_the_camera_and_the_controls(browser: Browser, home: Path) -> None:
    with served("nerf", "view", "runs/a", cwd=home) as address, browser.open(address) as window:
        until(window, lambda: scene_picture(window).std() > 5)
        window.page.get_by_text("frame 0000000000, 1 of 4: trained on").wait_for()
        before = still(window)
        slider = window.page.get_by_role("slider").first
        slider.focus()
        slider.press("ArrowRight")
        window.page.get_by_text("frame 0000000001, 2 of 4: trained on").wait_for()
        until(window, changed(window, before))
        before = still(window)
        window.page.mouse.move(400, 500)
        window.page.mouse.down()
        window.page.mouse.move(500, 520, steps=5)
        window.page.mouse.up()
        until(window, changed(window, before))
        before = still(window)
        window.page.get_by_role("checkbox", name="show", exact=True).check()
        until(window, changed(window, before))
        before = still(window)
        window.page.get_by_label("picture", exact=True).click()
        window.page.get_by_role("option", name="depth").click()
        until(window, changed(window, before))
        assert not window.errors and not window.left


def still(window: Window) -> np.ndarray:
    """The 3D part once it changes no more."""
    before = scene_picture(window)
    for _ in range(50):
        window.page.wait_for_timeout(400)
        now = scene_picture(window)
        if np.abs(now - before).mean() < 0.05:
            return now
        before = now
    raise AssertionError("it never stands still")
