"""The report: an exact field scores perfectly, a wrong one by how wrong it is, and a killed report goes on."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from eval.lpips import Lpips
from eval.result import Result
from nerf.pictures import KEPT, picture_path
from nerf.report import Report, Scoring, Subject, report
from nerf.scene import Scene
from nerf.truths import Truths
from nerf.types import RenderedView
from priors import codecs
from priors.errors import DataError
from priors.geometry import rays
from priors.types import Camera, Depth, Frame, Sweep

CAMERA = Camera(np.array([[40.0, 0, 24], [0, 40, 15], [0, 0, 1]]), (33, 50))
IDS = [f"{number:06d}" for number in range(22)]
WALL_M = 40.0
STEP_M = 1.0
INFO = {"name": "exact", "config": {"field": "ngp"}}


def pose(z_m):
    T_world_cam = np.eye(4)
    T_world_cam[2, 3] = z_m
    return T_world_cam


def exact(T_world_cam, camera=CAMERA):
    """A patterned wall at z = 40 m, rendered exactly; the top rows are sky."""
    depth_m = np.full(camera.size, WALL_M - T_world_cam[2, 3], np.float32)
    place = T_world_cam[:3, 3] + rays(camera) * depth_m[..., None]
    rgb = np.rint(127.5 * (1 + np.sin(place * [0.9, 1.3, 1] + [0, 1, 2]))) / 255
    opacity = np.ones_like(depth_m)
    opacity[:4] = 0.2
    return RenderedView(rgb.astype(np.float32), depth_m, depth_m, opacity)


def truth_at(z_m):
    depth_m = exact(pose(z_m)).depth_m.copy()
    depth_m[:10] = 0
    return Depth(depth_m)


class Wall:
    """A drive towards the wall. truth: which frames have a true depth; sweeps: which a LiDAR."""

    name = "wall"
    ids = IDS

    def __init__(self, truth=True, sweeps=False):
        self.truth, self.sweeps = truth, sweeps

    def __len__(self):
        return len(IDS)

    def __getitem__(self, index):
        z_m = index * STEP_M
        readers = {}
        if self.truth:
            readers["truth"] = lambda: truth_at(z_m)
        if self.sweeps:
            depth_m = truth_at(z_m).depth_m
            xyz = (rays(CAMERA) * depth_m[..., None])[depth_m > 0].astype(np.float32)
            readers["sweep"] = lambda offset=0: None if index == 19 else Sweep(xyz, pose(z_m))
        return Frame(IDS[index], CAMERA, readers, {"truth": "it was not measured"}, pose(z_m), np.eye(4))


@pytest.fixture
def scene():
    poses = np.array([pose(i * STEP_M) for i in range(len(IDS))])
    images = np.array([np.rint(exact(T).rgb * 255) for T in poses]).astype(np.uint8)
    return Scene("wall", IDS, CAMERA, poses, images, None, None, list(range(9)), [9, 19])


def run(scene, folder, render=exact, drive=None, checkpoint="a", on_frame=lambda: None, **scoring):
    truths = Truths(Wall() if drive is None else drive, [scene.ids[i] for i in scene.test])
    return report(scene, truths, Subject(render, checkpoint, INFO), folder, Scoring(**scoring), on_frame)


def test_an_exact_field_is_perfect(scene, tmp_path):
    made = run(scene, tmp_path)
    found = made.metrics()
    assert [frame.frame for frame in made.frames] == ["000009", "000019"]
    assert found["psnr_uint8"] == math.inf
    assert found["psnr"] > 140  # float32 against 8 bits
    assert found["ssim_uniform7"] == 1
    assert found["ssim_gauss11"] == pytest.approx(1, abs=1e-9)
    for key in ("rmse", "abs_rel", "mae", "median_rmse"):
        assert found[key] == 0
    assert found["density"] == found["median_density"] == found["delta_1"] == 1
    assert made.protocol.name == "paper"
    assert made.protocol.truth == "annotated"


def test_a_wrong_field_scores_how_wrong_it_is(scene, tmp_path):
    def wrong(T_world_cam, camera):
        view = exact(T_world_cam, camera)
        median_m = view.depth_m * np.float32(1.2)
        median_m[20:] = 0
        return replace(view, rgb=np.full_like(view.rgb, 0.5), depth_m=view.depth_m * np.float32(1.1), median_m=median_m)

    found = run(scene, tmp_path, wrong).metrics()
    assert found["abs_rel"] == pytest.approx(0.1, abs=1e-6)
    assert found["rmse"] == pytest.approx(0.1 * (31 + 21) / 2, abs=1e-5)
    assert found["median_abs_rel"] == pytest.approx(0.2, abs=1e-6)
    assert found["median_density"] == pytest.approx(10 / 23)
    errors = [np.mean((scene.images[i] / 255 - 0.5) ** 2) for i in scene.test]
    assert found["psnr"] == pytest.approx(np.mean([-10 * math.log10(e) for e in errors]), abs=1e-5)


def test_the_files_hold_what_was_rendered(scene, tmp_path):
    made = run(scene, tmp_path)
    for position in scene.test:
        id_ = scene.ids[position]
        paths = {kind: picture_path(tmp_path / "renders", kind, id_) for kind in KEPT}
        assert np.array_equal(codecs.read_image(paths["rgb"]), scene.images[position])
        depth_m = codecs.read_depth_png(paths["depth"])
        assert np.all(depth_m[:4] == 0)  # clearer than half: sky
        assert np.all(depth_m[4:] == WALL_M - position)
        assert codecs.read_image(paths["depth_colour"]).shape == (33, 50, 3)
        assert codecs.read_image(paths["error"]).shape[1] > 700
    assert Report.load(tmp_path / "metrics.json") == made
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert content["metrics"]["psnr_uint8"] == "inf"
    assert content["info"] == INFO
    depth = Result.load(tmp_path / "depth.json")
    assert depth.name == "exact"
    assert depth.metrics()["rmse"] == 0
    assert not list(tmp_path.rglob(".*"))


class Counting:
    """A renderer that counts, and stops like a kill at a given view."""

    def __init__(self, stop_at=None):
        self.count, self.stop_at = 0, stop_at

    def __call__(self, T_world_cam, camera):
        if self.count == self.stop_at:
            raise KeyboardInterrupt
        self.count += 1
        return exact(T_world_cam, camera)


def test_a_killed_report_goes_on(scene, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(scene, tmp_path, Counting(stop_at=1))
    assert not (tmp_path / "metrics.json").exists()
    with (tmp_path / "renders" / "scores.jsonl").open("a") as file:
        file.write('{"key": "a/paper", "fra')  # the kill came while writing
    seen, rest = [], Counting()
    made = run(scene, tmp_path, rest, on_frame=lambda: seen.append(1))
    assert (rest.count, len(seen)) == (1, 2)
    whole = run(scene, tmp_path / "whole")
    assert [replace(frame, seconds=0) for frame in made.frames] == [replace(f, seconds=0) for f in whole.frames]
    again = Counting()
    assert run(scene, tmp_path, again) == made
    assert again.count == 0


def test_another_checkpoint_or_a_lost_picture_is_rendered_again(scene, tmp_path):
    run(scene, tmp_path)
    other = Counting()
    run(scene, tmp_path, other, checkpoint="b")
    assert other.count == 2
    picture_path(tmp_path / "renders", "depth", "000019").unlink()
    one = Counting()
    run(scene, tmp_path, one, checkpoint="b")
    assert one.count == 1
    rules = Counting()
    run(scene, tmp_path, rules, checkpoint="b", protocol="garg")
    assert rules.count == 2


def test_without_weights_the_figure_is_absent_and_can_be_added(scene, tmp_path, monkeypatch):
    made = run(scene, tmp_path)
    assert not any(key.startswith("lpips") for key in made.metrics())
    assert "--lpips-weights" in made.remarks[0]
    monkeypatch.setattr(Lpips, "__call__", lambda self, image, truth: float(np.mean(image)) / 255)
    later = Counting()
    added = run(scene, tmp_path, later, lpips=Lpips("squeeze", {}, []))
    assert later.count == 0
    assert added.metrics()["lpips_squeeze"] == pytest.approx(np.mean(scene.images[[9, 19]]) / 255)
    assert added.remarks == ()
    both = run(scene, tmp_path, later, lpips=Lpips("vgg", {}, []))
    assert {"lpips_squeeze", "lpips_vgg"} <= both.metrics().keys()


def test_without_a_true_depth_lidar_is_the_truth(scene, tmp_path):
    made = run(scene, tmp_path, drive=Wall(truth=False, sweeps=True))
    assert made.protocol.truth == "lidar"
    assert made.frames[0].depth.depth.truth > 500
    assert made.metrics()["rmse"] == pytest.approx(0, abs=1e-5)
    assert made.frames[1].depth is None  # the sweep is missing: no figure, and no failure
    assert Report.load(tmp_path / "metrics.json") == made


def test_without_any_truth_depth_figures_are_absent(scene, tmp_path):
    made = run(scene, tmp_path, drive=Wall(truth=False))
    assert math.isnan(made.metrics()["rmse"])
    assert made.metrics()["psnr_uint8"] == math.inf
    assert made.remarks[0] == "no depth figures: it was not measured"
    assert not (tmp_path / "depth.json").exists()
    assert json.loads((tmp_path / "metrics.json").read_text())["metrics"]["rmse"] is None
    assert Report.load(tmp_path / "metrics.json") == made


def test_what_cannot_be_reported_is_said_in_one_line(scene, tmp_path):
    def diverged(T_world_cam, camera):
        return replace(exact(T_world_cam, camera), rgb=np.full((33, 50, 3), np.nan, np.float32))

    with pytest.raises(DataError, match="wall: frame 000009: image has 4950 values that are not finite"):
        run(scene, tmp_path, diverged)
    with pytest.raises(DataError, match="none of the 22 frames is held out"):
        run(replace(scene, test=[]), tmp_path)
    for damaged in ("{", '{"format": 1}', "[]"):
        (tmp_path / "metrics.json").write_text(damaged)
        with pytest.raises(DataError, match=r"expected a run's metrics, found damaged or other data: run nerf eval"):
            Report.load(tmp_path / "metrics.json")
    (tmp_path / "metrics.json").write_text('{"format": 2}')
    with pytest.raises(DataError, match="metrics of format 2, expected 1"):
        Report.load(tmp_path / "metrics.json")
    with pytest.raises(DataError, match="cannot be read"):
        Report.load(tmp_path / "nowhere.json")
