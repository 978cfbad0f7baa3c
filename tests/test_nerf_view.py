"""`nerf view` without a browser: coarse to fine, newer cameras, several browsers, what a run has beside its field."""

import shutil
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from factories import STEP_M, write_folder
from hypothesis import given
from hypothesis import strategies as st

from cli.nerf import PROGRAM
from nerf import fields
from nerf.config import FitConfig, ModelConfig
from nerf.prepare import SceneConfig
from nerf.run import Run, begin, open_run
from nerf.types import RenderedView
from nerf.view import lens
from nerf.view.painter import Painter
from nerf.view.picture import FIRST_S, Picture, levels, pieces, rows_of
from nerf.view.stage import open_stage
from nerf.view.turns import Turns
from priors.drives import open_drive
from priors.errors import DataError
from priors.geometry import rays
from priors.types import Camera, Matrix
from priors.view.track import fitting_fov, quaternion

CAMERA = Camera(np.array([[60.0, 0, 31.5], [0, 60, 19.5], [0, 0, 1]]), (40, 64))


def render(T_world_cam: Matrix, camera: Camera) -> RenderedView:
    """A field whose colour is the ray, and whose depth is the place along the world's x."""
    directions = rays(camera).astype(np.float32)
    depth_m = np.full(camera.size, T_world_cam[0, 3] + 5, np.float32)
    return RenderedView(directions / 2 + 0.5, depth_m, depth_m, np.ones_like(depth_m))


def draw(picture: Picture, renderer: Callable[[Matrix, Camera], RenderedView] = render) -> int:
    """Draw a picture to its end; returns how many pieces that took."""
    count = 0
    while not picture.whole:
        piece = picture.take()
        picture.paste(piece, renderer(picture.T_world_cam, piece.camera))
        count += 1
    return count


@given(st.integers(1, 300), st.integers(1, 500), st.integers(1, 10**6))
def test_levels_go_from_a_coarse_one_to_the_whole(height: int, width: int, first: int) -> None:
    sizes = levels((height, width), first)
    pixels = [h * w for h, w in sizes]
    assert sizes[-1] == (height, width) and pixels[0] <= first
    assert all(small < large for small, large in pairwise(pixels))
    assert sum(pixels[1:-1]) <= pixels[-1] / 3 + height + width, "the levels between cost little"


@given(st.integers(1, 120), st.integers(1, 200), st.floats(1, 1e7))
def test_a_level_s_pieces_cover_each_row_once(height: int, width: int, speed: float) -> None:
    camera = Camera(CAMERA.K, (height, width))
    covered: list[int] = []
    for piece in pieces(camera, speed):
        rows = rows_of(piece, height)
        covered += range(rows.start, rows.stop)
        if piece.last:
            assert covered == list(range(height))
            covered = []
    assert not covered


def test_the_first_piece_is_the_whole_view_and_fits_into_its_time() -> None:
    speed = 4000.0
    first = next(pieces(CAMERA, speed))
    assert first.first and first.last and first.camera.size[0] * first.camera.size[1] <= FIRST_S * speed
    picture = Picture(np.eye(4), CAMERA, speed)
    picture.paste(picture.take(), render(np.eye(4), first.camera))
    whole = render(np.eye(4), CAMERA)
    assert not picture.whole and np.abs(picture.rgb - whole.rgb).max() < 0.05, "a coarse picture of the same view"
    assert draw(picture) > 3
    np.testing.assert_allclose(picture.rgb, whole.rgb, atol=1e-6)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that has begun, on six frames of a folder."""
    home = tmp_path_factory.mktemp("run")
    drive = open_drive(write_folder(home / "mine", list("abcdef")))
    return begin(drive, None, SceneConfig(frames="0:5"), FitConfig(steps=1), home / "runs" / "a")


@pytest.mark.parametrize("family", ["ngp", "mip360"])
def test_a_finished_picture_is_what_the_field_renders_in_one_go(run: Run, family: str) -> None:
    config = FitConfig(ModelConfig(family=family, log2_size=12), rays=64)
    model = fields.family(family).start(run.scene, config, "cpu")
    pose = run.scene.T_world_cam[1]
    picture = Picture(pose, CAMERA, 5000.0)
    assert draw(picture, model.render) > 3
    whole = model.render(pose, CAMERA)
    for name in ("rgb", "depth_m", "median_m", "opacity"):
        np.testing.assert_array_equal(getattr(picture.view(), name), getattr(whole, name))


def test_browsers_take_turns() -> None:
    turns, order = Turns(), []
    for client in (1, 2):
        turns.begin(client, Picture(np.eye(4), CAMERA, 5000.0))
    for step in range(40):
        found = turns.next()
        if found is None:
            break
        client, picture = found
        picture.take()
        order.append(client)
        if step < 6:
            turns.begin(1, Picture(np.eye(4), CAMERA, 5000.0))  # one moves all the time
    assert order[:8] == [1, 2] * 4 and turns.next() is None
    turns.leave(1)
    assert turns.picture(1) is None


def at(x_m: float) -> Matrix:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


def slowly(T_world_cam: Matrix, camera: Camera) -> RenderedView:
    """Render 12,000 rays a second: CAMERA takes 0.2 s."""
    time.sleep(camera.size[0] * camera.size[1] / 12_000)
    return render(T_world_cam, camera)


def test_a_newer_camera_gives_the_older_picture_up_and_what_stands_still_becomes_whole() -> None:
    last, places = 8, list[float]()
    shown, done = list[tuple[int, float, bool]](), threading.Event()

    def field(T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """While it renders, the browser's camera moves on, up to the last place."""
        places.append(float(T_world_cam[0, 3]))
        if places[-1] < last:
            painter.ask(7, at(places[-1] + 1), CAMERA)
        return slowly(T_world_cam, camera)

    def deliver(client: int, picture: Picture) -> None:
        shown.append((client, float(picture.T_world_cam[0, 3]), picture.whole))
        if picture.whole:
            done.set()

    painter = Painter(field, deliver)
    painter.rays_a_second = 12_000.0
    painter.start()
    painter.ask(7, at(0), CAMERA)
    assert done.wait(20)
    painter.stop()
    assert places[: last + 1] == list(range(last + 1)) and places.count(last) > 1, "nothing is finished in vain"
    assert [x_m for _, x_m, whole in shown if not whole][: last + 1] == list(range(last + 1)), "pictures follow"
    assert shown[-1] == (7, last, True)


def test_a_fault_of_the_field_is_kept() -> None:
    def broken(pose: Matrix, camera: Camera) -> RenderedView:
        raise DataError("no field")

    painter = Painter(broken, lambda client, picture: None)
    painter.start()
    painter.ask(1, np.eye(4), CAMERA)
    deadline = time.monotonic() + 10
    while painter.fault is None and time.monotonic() < deadline:
        time.sleep(0.005)
    assert str(painter.fault) == "no field"


def test_a_browser_that_has_left_is_not_drawn_for() -> None:
    shown: list[int] = []
    painter = Painter(render, lambda client, picture: shown.append(client))
    painter.ask(1, np.eye(4), CAMERA)
    painter.leave(1)
    painter.ask(2, np.eye(4), CAMERA)
    painter.start()
    deadline = time.monotonic() + 10
    while not shown and time.monotonic() < deadline:
        time.sleep(0.005)
    assert 1 not in shown and 2 in shown and painter.picture(1) is None
    painter.stop()


@pytest.mark.parametrize("aspect", [0.5, 1.6, 3.0])
def test_the_browser_s_camera_shows_the_whole_of_a_drive_s(aspect: float) -> None:
    seen = lens.browser_camera(fitting_fov(CAMERA, aspect), aspect, 3000)
    height, width = seen.size
    assert height * width == pytest.approx(3000, rel=0.05) and width / height == pytest.approx(aspect, rel=0.05)
    half = np.array([width / 2 / seen.K[0, 0], height / 2 / seen.K[1, 1]])
    assert (half >= np.array([32 / 60, 20 / 60]) - 1e-6).all() and np.isclose(half, [32 / 60, 20 / 60]).any()


def test_a_browser_s_pose_is_in_the_drive_s_coordinates() -> None:
    turned = np.array([[0, 0, 1, 4.0], [-1, 0, 0, 5], [0, -1, 0, 6], [0, 0, 0, 1]])
    origin_m = np.array([455000.3, 5428000.7, 110.0])
    pose = lens.browser_pose(quaternion(turned), turned[:3, 3], origin_m)
    np.testing.assert_allclose(pose[:3, :3], turned[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(pose[:3, 3], turned[:3, 3] + origin_m)


def test_surfaces_hide_and_the_sky_does_not() -> None:
    view = render(np.eye(4), CAMERA)
    view.opacity[:20] = 0
    assert (lens.hiding_m(view)[:20] == lens.FARTHEST_M).all() and (lens.hiding_m(view)[20:] == 5).all()
    assert not lens.colours(view, depth=True)[:20].any() and lens.colours(view, depth=True)[20:].any()


def test_a_stage_has_the_run_s_cameras(run: Run) -> None:
    stage = open_stage(open_run(run.folder))
    assert stage.track.ids == list("abcde") and stage.parts == ["trained on"] * 5 and not stage.has_points
    np.testing.assert_allclose(stage.track.path_m()[:, 2], STEP_M * np.arange(5))
    assert open_stage(open_run(run.folder), "1:3").track.ids == ["b", "c"]


def test_a_run_whose_data_moved_has_the_cameras_that_were_prepared(run: Run, tmp_path: Path) -> None:
    _ = run.scene  # prepared
    moved = tmp_path / "moved"
    shutil.copytree(run.folder.parents[1], moved)
    text = (moved / "runs" / "a" / "config.json").read_text().replace(str(run.folder.parents[1]), "/nowhere")
    (moved / "runs" / "a" / "config.json").write_text(text)
    stage = open_stage(open_run(moved / "runs" / "a"))
    assert stage.track.ids == list("abcde") and "cannot be opened" in stage.remarks[0] and stage.drive is None
    np.testing.assert_array_equal(stage.camera.K, run.scene.camera.K)
    shutil.rmtree(moved / "runs" / ".scenes")
    bare = open_stage(open_run(moved / "runs" / "a"))
    assert bare.track.ids == ["start"] and "no camera is known" in bare.remarks[1]


def test_without_viser_a_line_says_how_to_install_it(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert PROGRAM.run(["view", str(run.folder)]) == 1
    assert capsys.readouterr().err.rstrip().endswith("pip install 'roadprior[view]'")


def test_a_run_that_was_never_trained_is_one_line(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["view", str(run.folder)]) == 1
    assert "no checkpoint: train first" in capsys.readouterr().err
