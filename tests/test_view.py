"""`priors view` without a browser: points, poses, what is told, ports; and its controls in viser's server."""

import json
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import BASELINE_M, FX, SIZE, STEP_M, depth_m, scene, write_folder

from cli.priors import PROGRAM
from priors import cache, codecs
from priors.cache import Prior
from priors.draw.colours import colour_error
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.geometry import project
from priors.types import Camera, Depth
from priors.view import server
from priors.view.cloud import back_project, place
from priors.view.legend import legend
from priors.view.newest import Newest
from priors.view.panel import DrivePanel, escaped
from priors.view.scene import Choice, DriveScene, spread
from priors.view.track import Track, fitting_fov, quaternion

IDS = ("a", "b", "c")
FAR_M = np.array([455000.3, 5428000.7, 110.0])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "mine", IDS)


@pytest.fixture
def prior(folder: Path, tmp_path: Path) -> Prior:
    """Maps of the first two frames, 10 % too far, surer from left to right."""
    home = tmp_path / "cache" / "mine" / "made-0123456789"
    drive = open_drive(folder)
    manifest = {"format": 1, "key": "0123456789", "method": "made", "drive": {"name": drive.name, **drive.describe()}}
    home.mkdir(parents=True)
    (home / "manifest.json").write_text(json.dumps(manifest))
    found_m = (1.1 * depth_m(scene()[2])).astype(np.float32)
    confidence = np.tile(np.linspace(0.0, 1.0, SIZE[1], dtype=np.float32), (SIZE[0], 1))
    for id_ in IDS[:2]:
        codecs.write_depth_png(home / "depth" / f"{id_}.png", found_m)
        codecs.write_confidence_png(home / "confidence" / f"{id_}.png", confidence)
    return cache.only(home)


def scene_of(folder: Path, prior: Prior | None = None, most: int = 400_000) -> DriveScene:
    return DriveScene(open_drive(folder), [0, 1, 2], {} if prior is None else {"made": prior}, most)


def test_points_are_the_pixels_rays_times_depth_in_the_view_s_frame() -> None:
    random = np.random.default_rng(3)
    camera = Camera(np.array([[5.0, 0, 3.2], [0, 4.0, 1.9], [0, 0, 1]]), (4, 7))
    depth = Depth(random.uniform(1, 50, (4, 7)).astype(np.float32))
    kept = random.random((4, 7)) < 0.6
    picture = random.integers(0, 256, (4, 7, 3)).astype(np.uint8)
    pose = np.array([[0, 0, 1, 3.0], [-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 0, 1]])
    expected, colours = [], []
    for v in range(4):
        for u in range(7):
            if kept[v, u]:
                z = depth.depth_m[v, u]
                expected.append((pose @ [(u - 3.2) / 5 * z, (v - 1.9) / 4 * z, z, 1])[:3])
                colours.append(picture[v, u])
    cloud = back_project(camera, depth, kept, picture, pose, 100)
    np.testing.assert_allclose(cloud.xyz_m, expected, rtol=1e-5)
    np.testing.assert_array_equal(cloud.rgb, colours)
    assert (len(cloud), cloud.whole) == (kept.sum(), kept.sum()) and cloud.xyz_m.dtype == np.float32


@pytest.mark.parametrize("most", [1, 3, 27, 28, 1000])
def test_points_are_bounded_and_the_whole_is_told(most: int) -> None:
    camera = Camera(np.array([[5.0, 0, 3], [0, 5, 1.5], [0, 0, 1]]), (4, 7))
    depth, picture = Depth(np.ones((4, 7), np.float32)), np.zeros((4, 7, 3), np.uint8)
    cloud = back_project(camera, depth, depth.valid, picture, np.eye(4), most)
    assert cloud.whole == 28 and 0 < len(cloud) <= most and (len(cloud) == 28) == (most >= 28)
    xyz_m = np.full((10, 3), np.nan)
    xyz_m[:4] = 1
    sweep = place(xyz_m, np.eye(4), most)
    assert sweep.whole == 4 and 0 < len(sweep) <= most and np.isfinite(sweep.xyz_m).all()


def test_a_map_of_another_size_is_named() -> None:
    camera = Camera(np.eye(3), (4, 7))
    with pytest.raises(DataError, match="the map is 3x2, the camera 7x4"):
        back_project(
            camera, Depth(np.ones((2, 3), np.float32)), np.ones((2, 3), bool), np.zeros((2, 3, 3)), np.eye(4), 9
        )


def test_a_drive_far_from_its_origin_looks_like_one_near_it(folder: Path, prior: Prior, tmp_path: Path) -> None:
    far = write_folder(tmp_path / "far", IDS)
    rows = np.loadtxt(far / "poses.txt").reshape(-1, 3, 4)
    rows[:, :, 3] += FAR_M
    np.savetxt(far / "poses.txt", rows.reshape(-1, 12), fmt="%.9f")
    choice = Choice(together=2, prior="made")
    near, moved = scene_of(folder, prior), scene_of(far, prior)
    np.testing.assert_allclose(moved.show(choice).points.xyz_m, near.show(choice).points.xyz_m, atol=1e-5)
    np.testing.assert_allclose(moved.track.path_m(), [[0, 0, i * STEP_M] for i in range(3)], atol=1e-6)
    np.testing.assert_allclose(moved.track.origin_m, FAR_M, atol=1e-6)
    assert moved.track.far() and not near.track.far()


def test_colours_and_thresholds_choose_the_points(folder: Path, prior: Prior) -> None:
    view = scene_of(folder, prior)
    every = view.show(Choice(prior="made"))
    assert len(every.points) == SIZE[0] * SIZE[1] and not every.remarks and every.caption() == "23,040 points"
    np.testing.assert_array_equal(every.points.rgb, view.thumbnail(0).reshape(-1, 3))
    sure = view.show(Choice(prior="made", least_confidence=0.75)).points
    assert len(sure) == pytest.approx(0.25 * len(every.points), rel=0.02)
    near_m = 1.1 * FX * BASELINE_M / 10
    near = view.show(Choice(prior="made", farthest_m=near_m + 0.01)).points
    assert 0 < len(near) < len(every.points) and near.xyz_m[:, 2].max() <= near_m + 0.01
    error = view.show(Choice(prior="made", colouring="error")).points
    wanted = colour_error(prior.read("a").depth_m, open_drive(folder)[0].truth().depth_m)
    np.testing.assert_array_equal(error.rgb, wanted.reshape(-1, 3))
    for colouring in ("depth", "confidence"):
        assert len(np.unique(view.show(Choice(prior="made", colouring=colouring)).points.rgb, axis=0)) > 5


def test_several_frames_share_the_points(folder: Path, prior: Prior) -> None:
    view = scene_of(folder, prior, most=1000)
    both = view.show(Choice(together=2, prior="made"))
    assert both.points.whole == 2 * SIZE[0] * SIZE[1] and 800 < len(both.points) <= 1000
    assert both.caption() == f"{len(both.points):,} of 46,080 points"
    assert list(view.together(Choice(position=2, together=9))) == [2]


def test_what_cannot_be_shown_is_said_and_the_rest_is_shown(folder: Path, prior: Prior) -> None:
    prior.depth_path("b").write_bytes(b"cut")
    shown = scene_of(folder, prior).show(Choice(together=3, prior="made", sweeps=True))
    assert len(shown.points) == SIZE[0] * SIZE[1]
    told = "\n".join(shown.remarks)
    assert "b.png" in told and "frame c: made has no map of it" in told and "has no LiDAR" in told
    (folder / "depth" / "a.png").unlink()
    assert "frame a" in scene_of(folder, prior).show(Choice(prior="made", colouring="error")).remarks[0]


def test_without_poses_frames_are_shown_one_at_a_time(folder: Path, prior: Prior) -> None:
    (folder / "poses.txt").unlink()
    view = scene_of(folder, prior)
    assert not view.track.posed and list(view.together(Choice(position=1, together=3))) == [1]
    np.testing.assert_array_equal(view.track.pose(1), np.eye(4))


def test_a_frame_without_a_pose_is_not_placed_among_the_others() -> None:
    track = Track(["a", "b"], [None, np.eye(4)], np.zeros(3), True)
    assert track.pose(0) is None and track.path_m().shape == (1, 3)
    np.testing.assert_allclose(track.up(), [0, -1, 0])
    assert quaternion(np.eye(4)) == (1, 0, 0, 0)


@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5, 6.0])
def test_a_window_of_any_shape_shows_the_whole_camera(aspect: float) -> None:
    camera = Camera(np.array([[200.0, 0, 119.5], [0, 210, 47.5], [0, 0, 1]]), (96, 240))
    tangent = np.tan(fitting_fov(camera, aspect) / 2)
    window = Camera(np.array([[1 / (tangent * aspect), 0, 0], [0, 1 / tangent, 0], [0, 0, 1]]), (2, 2))
    corner = np.array([[120 / 200, 48 / 210, 1.0]])
    uv, _ = project(window, corner)
    assert uv.max() == pytest.approx(1, abs=1e-6), "the corner lies on the window's edge, none outside"


def test_frames_are_spread_evenly() -> None:
    assert list(spread(5, 8)) == [0, 1, 2, 3, 4]
    assert list(spread(101, 5)) == [0, 25, 50, 75, 100]


def test_the_newest_wish_overtakes_the_others() -> None:
    begun, go = [], threading.Event()

    def work(wish: int) -> None:
        begun.append(wish)
        go.wait(10)

    newest = Newest(work)
    newest.ask(0)
    while not begun:
        time.sleep(0.001)
    for wish in (1, 2, 3):
        newest.ask(wish)
    go.set()
    assert newest.settle(10) and begun == [0, 3]
    newest.stop()
    newest.ask(4)
    assert begun == [0, 3], "nothing is begun after the end"


def test_a_fault_of_the_work_ends_the_view() -> None:
    def work(wish: str) -> None:
        raise ValueError(wish)

    newest = Newest(work)
    newest.ask("broken")
    with pytest.raises(ValueError, match="broken"):
        server.wait(lambda: newest.fault)


def test_ports_are_found_or_refused_in_a_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        with pytest.raises(DataError, match=f"--port {port}: in use by another program"):
            server.free_port("localhost", port)
        before, server.PORT = server.PORT, port
        try:
            assert server.free_port("localhost", None) > port
        finally:
            server.PORT = before
    for host, says in (("no such host", "no such host"), ("203.0.113.7", "not an address of this machine")):
        with pytest.raises(DataError, match=says):
            server.free_port(host, None)
    for port in (-1, 65536):
        with pytest.raises(UsageError, match="--port"):
            server.check_port(port)


def test_without_viser_a_line_says_how_to_install_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert PROGRAM.run(["view", str(folder)]) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1 and told[0].endswith("pip install 'roadprior[view]'")


def test_legends_are_drawn_for_all_but_the_image() -> None:
    assert legend("image") is None
    for colouring in ("depth", "error", "confidence"):
        picture = legend(colouring)
        assert picture is not None and len(np.unique(picture.reshape(-1, 3), axis=0)) > 7


def test_names_are_no_markdown() -> None:
    assert escaped("a*b_[c]") == "a\\*b\\_\\[c\\]"


def test_several_drives_in_a_cache_are_listed(prior: Prior, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "cache" / "other" / prior.name
    other.mkdir(parents=True)
    manifest = prior.manifest | {"drive": prior.drive | {"name": "other", "path": str(tmp_path / "other")}}
    (other / "manifest.json").write_text(json.dumps(manifest))
    assert PROGRAM.run(["view", str(tmp_path / "cache")]) == 2
    told = capsys.readouterr().err
    assert "holds 2 drives" in told and f"priors view {tmp_path / 'cache' / 'mine'}" in told


def test_the_controls_change_what_is_shown(folder: Path, prior: Prior, capfd: pytest.CaptureFixture[str]) -> None:
    with server.opened("localhost", 0, "a test") as (opened, address):
        assert address.startswith("http://localhost:") and not address.endswith(":0")
        panel = DrivePanel(opened, scene_of(folder, prior))

        def shown() -> Any:
            assert panel.newest.settle(20) and panel.newest.fault is None
            return panel.shown

        assert len(shown().points) == SIZE[0] * SIZE[1]
        for control, value in ((panel.confidence, 0.5), (panel.colouring, "error"), (panel.together, 2)):
            before = shown()
            control.value = value
            deadline = time.monotonic() + 20
            while panel.shown is before and time.monotonic() < deadline:
                time.sleep(0.01)
            assert shown() is not before
        assert "a to b" in panel.told.content and panel.legend.visible
        panel.frame.value = 2
        deadline = time.monotonic() + 20
        while "no map" not in panel.told.content and time.monotonic() < deadline:
            time.sleep(0.01)
        assert "frame c: made has no map of it" in panel.told.content.replace("\\", "")
        panel.path.value = False
        panel.size.value = 0.2
        panel.close()
    assert capfd.readouterr() == ("", ""), "viser says nothing"
