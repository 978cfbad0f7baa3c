"""The warp: it draws what another view sees, equals its slow twin, and is a field like the others but for training."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from factories import write_raw
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.nerf import fit as fit_command
from eval import typeset
from nerf import checkpoint
from nerf.baseline import unbeaten
from nerf.config import FitConfig, ModelConfig
from nerf.fields import family
from nerf.fit import fit
from nerf.kernels.cpu.warp_draw import NONE, draw
from nerf.kernels.cpu.warp_fuse import Fused, Views, fuse
from nerf.page import lay_out
from nerf.prepare import SceneConfig
from nerf.run import begin
from nerf.scene import Scene
from nerf.study import RunSpec, Study
from nerf.types import RenderedView
from nerf.warp.draw import between, rules_for
from nerf.warp.fill import fill
from nerf.warp.model import WarpModel
from nerf.warp.surface import joins_of, surface_of
from priors import build
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.geometry import rays
from priors.machine import threads
from priors.methods.lidar import Lidar
from priors.types import Camera
from tests.reference import warp as slow
from tests.test_nerf_fit import corridor
from tests.test_nerf_study import Runner

CAMERA = Camera(np.array([[30.0, 0, 15.5], [0, 30.0, 9.5], [0, 0, 1]]), (20, 32))
CONFIG = FitConfig(ModelConfig(family="warp"))


def warp(scene: Scene) -> WarpModel:
    return family("warp").start(scene, CONFIG, "cpu")  # type: ignore[return-value]


def view(scene: Scene) -> RenderedView:
    return warp(scene).render(scene.T_world_cam[scene.test[0]], scene.camera)


def pose(turn_rad: float = 0.0, *place_m: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = [[np.cos(turn_rad), 0, np.sin(turn_rad)], [0, 1, 0], [-np.sin(turn_rad), 0, np.cos(turn_rad)]]
    T[:3, 3] = place_m or (0, 0, 0)
    return T


def plane(T_world_cam: np.ndarray, normal: np.ndarray, off_m: float) -> np.ndarray:
    """Inverse depth (h, w) of the plane normal . x = off_m; below 0 behind the camera."""
    directions = rays(CAMERA) @ T_world_cam[:3, :3].T
    return directions @ normal / (off_m - normal @ T_world_cam[:3, 3])


def test_a_plane_is_seen_where_it_is_from_anywhere() -> None:
    """Also a road at a low angle, whose neighbouring rows differ by more than two surfaces may."""
    for normal, off_m in ((np.array([0.3, 0.2, 1.0]), 8.0), (np.array([0.0, 1.0, 0.0]), 1.5)):
        here, there = pose(), pose(0.1, 0.4, -0.2, 1.5)
        inverse = plane(here, normal, off_m).astype(np.float32)
        inverse[inverse <= 0.005] = NONE
        seen = np.full(CAMERA.size, NONE)
        draw(inverse, joins_of(inverse), between(CAMERA, here, CAMERA, there), seen)
        drawn = seen >= 0
        assert drawn.mean() > 0.3
        assert drawn[-6:, 8:-8].all()  # no tears
        error = np.abs(seen - plane(there, normal, off_m))[drawn]
        assert np.median(error) < 1e-6
        assert error.max() < 0.1  # the last pixels of the plane are drawn at their own depth, and half a pixel beyond


def test_the_nearer_surface_hides_the_farther() -> None:
    inverse = np.full(CAMERA.size, np.float32(0.05))
    inverse[5:15, 10:20] = 0.2
    for T in (pose(0, 0.5, 0, 0), pose(0, 0, 0, 2)):
        seen = np.full(CAMERA.size, NONE)
        draw(inverse, joins_of(inverse), between(CAMERA, pose(), CAMERA, T), seen)
        near, far = 1 / (5 - T[2, 3]), 1 / (20 - T[2, 3])
        known = seen >= 0
        assert np.all(np.isclose(seen[known], near) | np.isclose(seen[known], far))
        assert np.isclose(seen[10, 11], near)
        assert np.isclose(seen, near).sum() >= 100  # as large as it was, or larger


def scattered(seed: int) -> tuple[Views, np.ndarray, np.ndarray]:
    """Three views of noise about two surfaces, the matrices from them to the view, and their joins."""
    random = np.random.default_rng(seed)
    poses = [pose(*random.normal(0, [0.03, 0.4, 0.1, 0.6])) for _ in range(3)]
    inverse = np.where(random.random((3, *CAMERA.size)) < 0.2, 0.2, 0.08) * random.uniform(
        0.95, 1.05, (3, *CAMERA.size)
    )
    inverse = inverse.astype(np.float32)
    images = random.integers(0, 256, (3, *CAMERA.size, 3), dtype=np.uint8)
    there = np.stack([between(CAMERA, pose(), CAMERA, T) for T in poses])
    here = np.stack([between(CAMERA, T, CAMERA, pose()) for T in poses])
    trust = random.random((3, *CAMERA.size), dtype=np.float32)
    return Views(images, inverse, trust, there), here, np.stack([joins_of(each) for each in inverse])


@pytest.mark.parametrize("seed", [0, 1])
def test_the_kernels_equal_their_slow_twin(seed: int) -> None:
    views, here, joins = scattered(seed)
    seen = np.full((3, *CAMERA.size), NONE)
    for i in range(3):
        draw(views.inverse[i], joins[i], here[i], seen[i])
        np.testing.assert_allclose(seen[i], slow.draw(views.inverse[i], joins[i], here[i], CAMERA.size), rtol=1e-5)
    out = Fused(np.zeros((*CAMERA.size, 3), np.float32), np.full(CAMERA.size, NONE), np.zeros(CAMERA.size, np.bool_))
    fuse(seen, views, rules_for(CAMERA), 0, CAMERA.size[0], out)
    rgb, inverse = slow.fuse(seen, views, rules_for(CAMERA))
    assert np.array_equal(out.shown, np.isfinite(rgb[..., 0]))
    assert out.shown.mean() > 0.9
    np.testing.assert_allclose(np.where(out.inverse < 0, np.nan, out.inverse), inverse, rtol=1e-5)
    np.testing.assert_allclose(out.rgb[out.shown], rgb[out.shown], rtol=1e-4, atol=1e-3)


def test_held_out_views_are_shown_as_they_are() -> None:
    scene = corridor("sparse")
    shown = view(scene)
    assert -10 * np.log10(np.mean((shown.rgb - scene.images[scene.test[0]] / 255) ** 2)) > 27
    truth_m = corridor().depth_m[scene.test[0]]  # type: ignore[index]
    error = np.abs(shown.depth_m - truth_m)[truth_m > 0] / truth_m[truth_m > 0]
    assert np.median(error) < 0.002
    assert error.mean() < 0.03


def test_one_frame_that_is_wrong_is_outvoted() -> None:
    scene = corridor()
    assert scene.depth_m is not None
    depth_m = np.array(scene.depth_m[:])
    wrong = replace(scene, depth_m=depth_m)
    depth_m[scene.test[0] - 1, 8:16, 20:40] /= 3
    off = np.abs(view(wrong).rgb - view(scene).rgb)
    assert off.mean() < 0.01
    assert np.quantile(off, 0.99) < 0.2


@settings(max_examples=10, deadline=None)
@given(st.floats(-3, 3), st.tuples(*[st.floats(-900, 900)] * 3))
def test_where_the_world_begins_changes_nothing(turn_rad: float, place_m: tuple[float, float, float]) -> None:
    scene = corridor("4")
    moved = replace(scene, T_world_cam=pose(turn_rad, *place_m) @ scene.T_world_cam)
    ours, theirs = view(scene), view(moved)
    assert np.mean(np.abs(ours.rgb - theirs.rgb) > 1e-3) < 0.01
    assert np.mean(np.abs(ours.depth_m / theirs.depth_m - 1) > 1e-3) < 0.01


def test_threads_change_nothing() -> None:
    scene, views = corridor("4"), []
    for count in (1, 3):
        with threads.limited(count):
            views.append(view(scene))
    assert all(
        np.array_equal(getattr(views[0], name), getattr(views[1], name)) for name in ("rgb", "depth_m", "opacity")
    )


def test_what_no_frame_shows_is_filled_and_not_solid() -> None:
    scene = corridor("4")
    T = scene.T_world_cam[0].copy()
    T[:3, :3] = pose(1.0)[:3, :3]
    shown = warp(scene).render(T, scene.camera)
    assert 0.05 < (shown.opacity == 0).mean() < 0.95
    assert np.isfinite(shown.rgb).all()
    assert shown.rgb.min() > 0.05  # filled from around, not black
    assert np.isfinite(shown.depth_m).all()
    assert (shown.depth_m > 0).all()
    assert not shown.solid().depth_m[shown.opacity == 0].any()


def test_the_nearest_frames_are_those_that_look_the_same_way() -> None:
    scene = corridor()
    scene.T_world_cam[:10, :3, :3] = pose(np.pi)[:3, :3]  # the first half of the drive looks back
    model = warp(scene)
    assert model._warp is not None
    assert model._warp.frames.nearest(scene.T_world_cam[10], 4) == [10, 11, 12, 13]


def test_filling_keeps_what_is_known_and_constants() -> None:
    random = np.random.default_rng(0)
    values, known = random.random((13, 22, 2), dtype=np.float32), random.random((13, 22)) < 0.1
    filled = fill(values, known)
    assert np.array_equal(filled[known], values[known])
    low, high = values[known].min(axis=0), values[known].max(axis=0)
    assert np.all((filled >= low - 1e-5) & (filled <= high + 1e-5))
    assert np.allclose(fill(np.full((13, 22), np.float32(0.3)), known), 0.3)
    ramp = np.repeat(np.linspace(0, 1, 64, dtype=np.float32)[:, None], 64, axis=1)
    sparse = np.zeros((64, 64), bool)
    sparse[::3] = True
    assert np.abs(fill(ramp, sparse) - ramp).max() < 0.05
    assert np.array_equal(fill(np.zeros((3, 3), np.float32), np.zeros((3, 3), bool)), np.zeros((3, 3)))


def test_a_sparse_prior_becomes_whole_and_its_guesses_count_little() -> None:
    depth_m = np.full((16, 16), np.float32(10))
    depth_m[::2], depth_m[1, 1] = 0, np.nan
    surface = surface_of(depth_m, np.full((16, 16), 204, np.uint8))
    assert np.allclose(surface.inverse, 0.1)
    assert np.allclose(surface.trust[3::2], 0.8)
    assert np.allclose(surface.trust[::2], 0.1)
    assert surface.trust[1, 1] == np.float32(0.1)


def test_without_a_prior_it_says_what_it_needs() -> None:
    with pytest.raises(DataError, match="name a prior"):
        view(corridor(prior=False))
    with pytest.raises(UsageError, match="--field warp: shows the training frames"):
        fit_command.run(["nowhere", "--field", "warp"])


def test_a_fit_makes_it_at_once_and_a_checkpoint_has_no_tensor(tmp_path: Path) -> None:
    scene = corridor("4")
    fit(scene, CONFIG, tmp_path)
    assert checkpoint.spent(tmp_path).step == 0
    model = checkpoint.open_model(tmp_path)
    assert model.state() == {}
    assert isinstance(model, WarpModel)
    with pytest.raises(ValueError, match="show"):
        model.render(scene.T_world_cam[0], scene.camera)
    model.show(scene)
    again = model.render(scene.T_world_cam[scene.test[0]], scene.camera)
    assert np.array_equal(again.rgb, view(scene).rgb)
    assert scene.depth_m is not None
    other = replace(scene, depth_m=scene.depth_m[:] * np.float32(1.01))
    with pytest.raises(DataError, match="have changed since the run was made"):
        checkpoint.open_model(tmp_path).show(other)  # type: ignore[attr-defined]


def test_a_run_is_scored_and_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    drive = open_drive(write_raw(tmp_path, range(10)))
    prior = build.prepare(drive, Lidar(), folder=tmp_path / "cache").run().prior
    run = begin(drive, prior, SceneConfig(views="4"), CONFIG, tmp_path / "runs" / "warped")
    run.fit("cpu")
    report = run.report("cpu")
    assert report.metrics()["abs_rel"] < 0.5  # the scene drives along with the car
    assert checkpoint.spent(run.folder).step == 0
    run.render(run.viewpoints("2:4"), tmp_path / "views", "cpu")
    assert len(list((tmp_path / "views").rglob("*.png"))) == 6
    assert "no better than the warp" not in typeset.plain(lay_out(["warped"], [report]))
    assert run.folder.name == "warped"
    assert begin(drive, prior, fit=CONFIG).folder.name == f"{drive.name}-warp-dense-{prior.name}"  # it has no loss


def test_only_runs_of_the_same_views_are_compared(tmp_path: Path) -> None:
    made = Runner()
    none = [RunSpec("ngp", views, "none") for views in ("dense", "sparse")]
    specs = [RunSpec("warp", "dense", "cache/wall/stereo-abcdef0123"), *none]
    reports = [made(spec, tmp_path / spec.name, {"spec": asdict(spec)}) for spec in specs]
    (line,) = unbeaten(["w", "a", "b"], reports)
    assert "a (23.00, the warp 26.00)" in line
    assert "b (" not in line
    assert line in " ".join(typeset.plain(lay_out(["w", "a", "b"], reports)).split())
    assert unbeaten(["a", "b"], reports[1:]) == []
    better = replace(reports[0], info={"config": {"spec": asdict(specs[1])}})
    assert unbeaten(["w", "a"], [replace(reports[1], info=reports[0].info), better]) == []


def test_a_study_makes_it_once_a_prior() -> None:
    priors = ("none", "cache/wall/lidar-0123456789")
    study = Study(priors, ("mse", "l1"), ("sparse",), ("ngp", "warp"), seeds=(0, 1))
    names = [spec.name for spec in study.runs() if spec.field == "warp"]
    assert names == ["warp-sparse-lidar-0123456789-seed0"]
    assert len(study.runs()) == 2 * (1 + 2) + 1
    with pytest.raises(UsageError, match="name one by --priors cache/"):
        Study(fields=("warp",)).runs()
