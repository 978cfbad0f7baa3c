"""The tests' own browser: it sees what is drawn, hears what goes wrong, and lets nothing leave the machine."""

from pathlib import Path

import numpy as np
import pytest
from browser import Browser, chromium

PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>A page</title>
<style>:root { color-scheme: light dark } body { margin: 0 }</style>
<button style="width: 100px; height: 100px; border: 0; background: rgb(200, 0, 0)"
  onclick="this.style.background = 'rgb(0, 200, 0)'"></button>
<canvas width="60" height="60" style="display: block"></canvas>
<script>
const gl = document.querySelector("canvas").getContext("webgl", { preserveDrawingBuffer: true });
gl.clearColor(0, 0, 1, 1);
gl.clear(gl.COLOR_BUFFER_BIT);
</script>"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "a page.html"
    path.write_text(PAGE)
    return path


@pytest.mark.browser
def test_it_sees_what_is_drawn(browser: Browser, page: Path) -> None:
    with browser.open(page, width_px=400) as window:
        assert window.page.title() == "A page"
        assert window.picture("button").mean((0, 1)) == pytest.approx([200, 0, 0])
        window.page.click("button")
        assert window.picture("button").mean((0, 1)) == pytest.approx([0, 200, 0])
        assert window.picture("canvas").mean((0, 1)) == pytest.approx([0, 0, 255]), "WebGL without a GPU"
        assert window.picture().shape == (900, 400, 3)
        assert window.picture()[-1].min() == 255
        assert not window.errors and window.requests == [page.as_uri()]
    with browser.open(page, dark=True) as window:
        assert np.all(window.picture()[-1] < 60)


@pytest.mark.browser
def test_it_hears_errors_and_lets_nothing_leave(browser: Browser, page: Path) -> None:
    page.write_text(PAGE + "<script>console.error('a thing'); console.log('fine'); undefined.length</script>")
    with browser.open(page) as window:
        assert len(window.errors) == 2 and window.errors[0] == "a thing"
        assert not window.left
    page.write_text(PAGE + '<img src="https://example.org/a.png">')
    with browser.open(page) as window:
        assert window.left == ["https://example.org/a.png"]


def test_a_browser_that_is_not_there_is_a_skip_or_where_required_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROADPRIOR_CHROMIUM", "no-such-chromium")
    monkeypatch.delenv("ROADPRIOR_BROWSER", raising=False)
    with pytest.raises(pytest.skip.Exception, match="no no-such-chromium on this machine"):
        chromium()
    monkeypatch.setenv("ROADPRIOR_BROWSER", "required")
    with pytest.raises(pytest.fail.Exception, match="no no-such-chromium on this machine"):
        chromium()
