"""A real browser for tests: this machine's Chromium, driven by playwright; neither downloads anything.

    def test_a_page(browser: Browser) -> None:
        with browser.open(path_or_url, width_px=400, dark=True) as window:
            window.page.click("button")             # playwright's page
            assert window.picture().std() > 5       # what is seen
            assert not window.errors and window.left == []

`make browser` installs playwright and, where it can, Chromium, and runs the tests marked `browser`. Elsewhere they are
skipped with the reason; ROADPRIOR_BROWSER=required turns that into a failure. ROADPRIOR_CHROMIUM names another one.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--use-angle=swiftshader",  # WebGL without a GPU
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",  # containers have 64 MB there
    "--force-color-profile=srgb",
)
HOME = ("localhost", "127.0.0.1", "::1", None)
"""Hosts that are this machine; None: a file."""


class Window:
    """An open page, what went wrong in it, and what it asked for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        """playwright's Page."""
        self.errors: list[str] = []
        """Errors of the console and exceptions that nobody caught."""
        self.requests: list[str] = []
        """Addresses of all that was loaded, the page itself first; data: and blob: are no requests."""
        page.on("console", lambda told: self.errors.append(told.text) if told.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda asked: self._note(asked.url))

    @property
    def left(self) -> list[str]:
        """Requests that left this machine; the harness lets none through."""
        return [url for url in self.requests if urlsplit(url).hostname not in HOME]

    def picture(self, selector: str | None = None) -> np.ndarray:
        """What is seen of the window, or of an element that is scrolled to: (height, width, 3) RGB."""
        shot = self.page.screenshot() if selector is None else self.page.locator(selector).first.screenshot()
        return np.asarray(cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1])

    def save(self, path: Path) -> None:
        """Write the whole page as a PNG, for people to look at."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=path, full_page=True)

    def _note(self, url: str) -> None:
        if urlsplit(url).scheme not in ("data", "blob"):
            self.requests.append(url)


class Browser:
    """A running Chromium."""

    def __init__(self, running: Any) -> None:
        self.running = running
        """playwright's Browser."""

    @contextmanager
    def open(
        self, where: Path | str, width_px: int = 1400, height_px: int = 900, dark: bool = False
    ) -> Iterator[Window]:
        """Open a file or an address in a window of its own, until it is loaded."""
        scheme = "dark" if dark else "light"
        context = self.running.new_context(viewport={"width": width_px, "height": height_px}, color_scheme=scheme)
        try:
            context.route(lambda url: urlsplit(url).hostname not in HOME, lambda route: route.abort())
            window = Window(context.new_page())
            window.page.goto(where.resolve().as_uri() if isinstance(where, Path) else where)
            yield window
        finally:
            context.close()


@contextmanager
def started() -> Iterator[Browser]:
    """Start Chromium; skip with the reason where there is none, or fail where it is required."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        lacking("playwright is not installed: make browser")
    with sync_playwright() as playwright:
        flags = [*FLAGS, "--no-sandbox"] if os.geteuid() == 0 else [*FLAGS]
        running = playwright.chromium.launch(executable_path=chromium(), args=flags)
        try:
            yield Browser(running)
        finally:
            running.close()


def chromium() -> str:
    """Return Chromium's path."""
    named = os.environ.get("ROADPRIOR_CHROMIUM")
    found = shutil.which(named) if named else next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        lacking(f"no {named or ', '.join(NAMES)} on this machine: apt-get install chromium")
    return str(found)


def lacking(reason: str) -> None:
    """Skip, or fail where ROADPRIOR_BROWSER says that the browser is required."""
    if os.environ.get("ROADPRIOR_BROWSER") == "required":
        pytest.fail(reason)
    pytest.skip(reason)
