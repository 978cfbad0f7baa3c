"""Report pages in a real browser: they compare, sort and play, fit a phone, and ask nobody for anything."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, Window
from test_report_page import page

from cli.nerf import PROGRAM as NERF
from cli.priors import PROGRAM as PRIORS
from cli.program import Program
from priors.report.page import Page
from priors.street.write import write_street

pytestmark = pytest.mark.browser
HOSTILE = '"><img src=x onerror=alert(1)></script><script>alert(2)</script>[/]&{{1}}'


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a street's priors and of two fields, as `nerf report` writes it."""
    folder = tmp_path_factory.mktemp("home")
    street, cache, runs = folder / "street", folder / "cache", folder / "runs"
    write_street(street, 20, 7, (48, 160))
    for method in ("lidar", "stereo"):
        succeed(PRIORS, "build", street, "--method", method, "--cache", cache)
    prior = next(cache.glob("*/stereo-*"))
    succeed(NERF, "fit", street, "--steps", 40, "--run", runs / "alone")
    succeed(NERF, "fit", street, "--steps", 40, "--run", runs / "guided", "--prior", prior)
    succeed(NERF, "video", runs / "guided", "--frames", "2:4", "--steps", 1)
    succeed(NERF, "report", runs, "--cache", cache, "--most", 3, "--out", folder / "report.html")
    return folder / "report.html"


def succeed(program: Program, *words: object) -> None:
    assert program.run(list(map(str, words))) == 0


@pytest.fixture
def window(browser: Browser, report: Path) -> Iterator[Window]:
    with browser.open(report) as opened:
        yield opened
        assert not opened.errors and opened.requests == [report.as_uri()], "nothing goes wrong, nothing is asked for"


@pytest.mark.parametrize("width_px", [400, 1400])
def test_it_fits_its_window_by_day_and_by_night(browser: Browser, report: Path, width_px: int) -> None:
    papers = {}
    for dark in (False, True):
        with browser.open(report, width_px=width_px, dark=dark) as opened:
            wide = opened.page.evaluate("[...document.querySelectorAll('body *')].filter(e => !e.closest('.wide, svg')"
                                        " && e.getBoundingClientRect().right > innerWidth + 1).length")  # fmt: skip
            assert wide == 0 and opened.page.evaluate("document.documentElement.scrollWidth") == width_px
            papers[dark] = np.median(opened.picture(".plots"))
            assert not opened.errors and opened.requests == [report.as_uri()]
    assert papers[False] == 255 and papers[True] < 60


def test_dragging_the_divider_uncovers_the_other_picture(window: Window) -> None:
    before = stage(window)
    box = window.page.locator(".stage").first.bounding_box()
    middle_y = box["y"] + box["height"] / 2
    window.page.mouse.move(box["x"] + box["width"] / 2, middle_y)
    window.page.mouse.down()
    window.page.mouse.move(box["x"] + box["width"] / 4, middle_y, steps=4)
    window.page.mouse.up()
    after = stage(window)
    quarter, half = before.shape[1] // 4, before.shape[1] // 2
    changed = np.abs(before.astype(int) - after).mean((0, 2)) > 5
    assert changed[quarter + 40 : half - 40].mean() > 0.9, "what was left of the line is right of it now"
    assert not changed[: quarter - 40].any() and not changed[half + 40 :].any()
    divider = window.page.locator(".divider").first
    assert divider.get_attribute("aria-valuenow") == "25"


def stage(window: Window) -> np.ndarray:
    """The first wipe as it is seen, without the words at its upper edge."""
    shot = window.picture(".stage")
    return shot[shot.shape[0] // 4 :]


def test_the_divider_follows_the_keys(window: Window) -> None:
    divider = window.page.locator(".divider").first
    divider.focus()
    for key, place in (("Home", "0"), ("ArrowLeft", "0"), ("ArrowRight", "2"), ("PageUp", "12"), ("End", "100")):
        window.page.keyboard.press(key)
        assert divider.get_attribute("aria-valuenow") == place
    image = stage(window)[:, :-30]
    window.page.keyboard.press("Home")
    assert np.abs(stage(window)[:, 30:].astype(int).mean() - image.mean()) > 5, "the depth alone, not the image alone"


def test_frames_sides_and_methods_are_chosen(window: Window) -> None:
    find = window.page.locator(".wipe").first.locator
    tag = find(".tag.right")
    assert tag.inner_text().startswith("stereo: depth")
    find(".buttons button", has_text="lidar").click()
    assert tag.inner_text().startswith("lidar: depth")
    find("select.right").select_option(label="lidar: error")
    assert tag.inner_text().startswith("lidar: error AbsRel 0.")
    assert find(".legend:not([hidden])").count() == 1, "an image has no legend"
    assert "% of the true depth" in find(".legend:not([hidden])").inner_text()
    find("select.left").select_option(label="drive: true depth")
    assert find(".legend:not([hidden])").count() == 2
    first = find("img.right").get_attribute("src")
    find("input[type=range]").focus()
    window.page.keyboard.press("ArrowRight")
    assert "(2 of 3)" in find("output").inner_text()
    assert find("img.right").get_attribute("src") != first
    assert find("img.right").get_attribute("alt").startswith("lidar: error, frame 00000000")


def test_a_map_s_value_is_read_under_the_pointer(window: Window) -> None:
    window.page.locator(".stage").first.scroll_into_view_if_needed()
    box = window.page.locator(".stage").first.bounding_box()
    window.page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.95 * box["height"])
    reading = window.page.locator(".tag.right").first
    assert 3 <= float(reading.inner_text().split()[2]) < 10, "the road in front of the car, metres"
    window.page.mouse.move(0, 0)
    assert "of the pixels" in reading.inner_text()


def test_a_click_on_a_head_sorts_by_numbers(window: Window) -> None:
    table = window.page.locator("table.ranking").first
    rows = "[...document.querySelector('table.ranking').tBodies[0].rows].map(r => r.cells[COLUMN].textContent.trim())"
    heads = table.locator("th").all_inner_texts()
    column = next(place for place, head in enumerate(heads) if head.startswith("RMSE m"))
    before = window.page.evaluate(rows.replace("COLUMN", "0"))
    button = table.locator("th button").nth(column)
    found = []
    for _ in range(3):
        button.click()
        found.append([float(text) for text in window.page.evaluate(rows.replace("COLUMN", str(column)))])
    assert found[0] == sorted(found[0]) and found[1] == sorted(found[0], reverse=True), "the best first"
    assert window.page.evaluate(rows.replace("COLUMN", "0")) == before, "a third click restores the order"
    assert len(set(found[0])) == 2


def test_every_picture_of_the_fields_is_there_and_the_video_plays(window: Window) -> None:
    wipe = window.page.locator(".wipe").nth(1)
    assert [wipe.locator(f"select.{side} option:checked").inner_text() for side in ("left", "right")] == [
        "alone: colour",
        "guided: colour",
    ]
    wipe.locator(".buttons button", has_text="depth error").click()
    assert wipe.locator(".tag.left").inner_text().startswith("alone: depth error AbsRel")
    for place in range(wipe.locator("select.left option").count()):
        wipe.locator("select.left").select_option(index=place)
        image = wipe.locator("img.left").element_handle()
        window.page.wait_for_function("image => image.complete && image.naturalWidth == 160", arg=image)
    video = window.page.locator("video").element_handle()
    window.page.wait_for_function("video => video.readyState >= 2 && video.videoWidth == 160", arg=video)
    video.evaluate("video => video.play()")
    window.page.wait_for_function("video => video.currentTime > 0", arg=video)


def test_it_says_how_the_fits_went_and_the_same_results_give_the_same_bytes(report: Path) -> None:
    first = report.read_bytes()
    assert b"<h3>Course of the fits</h3>" in first
    runs, cache = report.parent / "runs", report.parent / "cache"
    succeed(NERF, "report", runs, "--cache", cache, "--most", 3, "--out", report)
    assert report.read_bytes() == first


def test_names_run_no_code(browser: Browser, tmp_path: Path) -> None:
    made: Page = page(HOSTILE)
    made.write(tmp_path / "a.html")
    with browser.open(tmp_path / "a.html") as opened:
        said: list[str] = []
        opened.page.on("dialog", lambda dialog: (said.append(dialog.message), dialog.dismiss()))
        assert opened.page.title() == f"Of {HOSTILE}"
        assert HOSTILE in opened.page.locator(".tag.right").first.inner_text()
        opened.page.locator("th button").first.click()
        assert opened.page.locator("img[src=x]").count() == 0
        assert not said and not opened.errors and not opened.left
