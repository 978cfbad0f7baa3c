"""Virtual views of a fit of Gaussians: which there are, what they show, and that they lift held-out views."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_nerf_fit import corridor
from test_splat_fit import config, psnr
from test_splat_start import with_sky

from nerf import checkpoint, fields
from nerf.config import FitConfig
from nerf.fit import fit
from nerf.gaussians import field_first, virtual
from nerf.gaussians import model as model_of_splats
from nerf.gaussians.config import GaussianConfig
from nerf.gaussians.field_first import FieldFirst
from nerf.gaussians.model import SplatModel
from nerf.gaussians.shot import Shot
from nerf.gaussians.virtual import PARTS, VirtualViews, is_virtual, pose_between, ways
from nerf.scene import Scene
from priors.errors import DataError, UsageError

pytestmark = pytest.mark.splats
CPU = torch.device("cpu")


@given(share=st.floats(0, 0.99), steps=st.integers(1, 400))
def test_a_share_of_the_steps_is_virtual(share: float, steps: int) -> None:
    assert sum(is_virtual(step, share) for step in range(steps)) == int(steps * share)


def test_ways_lead_along_the_path() -> None:
    scene = corridor("sparse")
    assert ways(scene.train, scene) == list(itertools.pairwise(scene.train))
    assert ways([3], scene) == []


def test_a_pose_between_two_is_on_the_way() -> None:
    first, second = np.eye(4), np.eye(4)
    first[:3, 3], second[:3, 3] = (1, 2, 3), (3, 2, 7)
    second[:3, :3] = Rotation.from_euler("y", 0.4).as_matrix()
    assert np.allclose(pose_between(first, second, 0.0), first)
    assert np.allclose(pose_between(first, second, 1.0), second)
    half = pose_between(first, second, 0.5)
    assert np.allclose(half[:3, 3], (2, 2, 5))
    assert np.allclose(half[:3, :3], Rotation.from_euler("y", 0.2).as_matrix())


def test_all_views_are_drawn_once_a_lap_in_an_order_by_the_seed() -> None:
    views = VirtualViews(corridor("8"), CPU)
    count = len(views.places)
    assert count == (PARTS - 1) * len(ways(corridor("8").train, corridor("8")))

    def places(seed: int, first: int) -> list[bytes]:
        return [views.shot(seed, number).viewpoint.T_world_cam.tobytes() for number in range(first, first + count)]

    assert len(set(places(0, 0))) == count
    assert sorted(places(0, 0)) == sorted(places(0, count)) == sorted(places(1, 0))
    assert places(0, 0) == places(0, 0) != places(1, 0)


def test_a_view_shows_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames between the training frames are known here: the corridor's own."""
    scene = corridor("4")
    views = VirtualViews(scene, CPU)
    between = {number: views.shot(0, number) for number in range(len(views.places))}
    at = {round(float(shot.viewpoint.T_world_cam[2, 3]) / 0.5, 3): shot for shot in between.values()}
    held = [position for position in range(len(scene.ids)) if position in at and position not in scene.train]
    assert held
    for position in held:
        shot = at[position]
        counts = shot.counts.numpy() > 0  # type: ignore[union-attr]
        assert counts.mean() > 0.9
        off = shot.rgb.numpy()[counts] - scene.images[position][counts] / 255
        assert -10 * np.log10(np.mean(off**2)) > 25
    monkeypatch.setattr(virtual, "KEPT_BYTES", 0)
    again = VirtualViews(scene, CPU)
    for number in (0, 1, 0):
        assert torch.equal(again.shot(0, number).rgb, between[number].rgb), "drawn again, it is the same"


def test_holes_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = corridor("4")
    views = VirtualViews(scene, CPU)
    fused = views._warp.fused

    def holed(*pose: Any) -> Any:
        out = fused(*pose)
        out.shown[:4] = False
        return out

    monkeypatch.setattr(views._warp, "fused", holed)
    counts = views.shot(0, 0).counts
    assert counts is not None and (counts[:4] == 0).all() and counts[4:].mean() > 0.9


@pytest.fixture(autouse=True)
def every_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ways of any length have views: the corridor is short."""
    monkeypatch.setattr(virtual, "LONG", 0.0)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Virtual views come from the first step on."""
    monkeypatch.setattr(model_of_splats, "LAPS", 0)


def trained(scene: Scene, share: float, steps: int = 60) -> SplatModel:
    settings = config(steps, start_step=3, virtual_views=share, virtual_until=1.0)
    model = fields.family("splat").start(scene, settings, "cpu")
    for step in range(steps):
        model.train(scene, settings, step, step / steps)
    assert isinstance(model, SplatModel)
    return model


def shot_at(model: SplatModel, scene: Scene, settings: FitConfig, step: int, progress: float = 0.0) -> Shot:
    return model._shot(scene, settings, step, model._virtual_share(scene, step, progress))


@pytest.mark.usefixtures("at_once")
def test_held_out_views_gain_by_them() -> None:
    scene = with_sky(corridor("1/8"))
    with_them, without = trained(scene, 0.5), trained(scene, 0.0)
    gain = [psnr(with_them, scene, position) - psnr(without, scene, position) for position in scene.test]
    assert np.mean(gain) > 0.05


@pytest.mark.usefixtures("at_once")
def test_there_are_none_without_a_prior_or_a_second_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field_first, "SHARE", 0.0)
    scene, settings = corridor("4", prior=False), config(2)
    model = fields.family("splat").start(scene, settings, "cpu")
    for step in range(2):
        model.train(scene, settings, step, step / 2)
    assert isinstance(model, FieldFirst) and isinstance(model.part, SplatModel) and model.part._virtual is None
    assert trained(replace(corridor("4"), train=[3]), 0.5, 2)._virtual is None


@pytest.mark.usefixtures("at_once")
def test_a_resumed_run_draws_the_same_views(tmp_path: Any) -> None:
    scene, settings = corridor("4"), config(12, virtual_views=0.4)
    whole = fit(scene, settings, tmp_path / "whole")

    class Killed(Exception):
        pass

    def kill(status: Any) -> None:
        if status.step == 7:
            raise Killed

    with pytest.raises(Killed):
        fit(scene, settings, tmp_path / "parts", kill)
    parts = fit(scene, settings, tmp_path / "parts")
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, parts.state()[name]), name


def test_a_run_of_before_goes_on_without_them(tmp_path: Any) -> None:
    from nerf.config import FitConfig
    from priors.records import record, restore

    told = record(config(4))
    for name in GaussianConfig.BEFORE:
        del told["model"]["gaussians"][name]
    before = restore(FitConfig, told).model.gaussians
    assert before.virtual_views == 0 and not before.appearance and before.low_pass_px2 == 0.2
    assert before.virtual_until == 0.8
    fit(corridor("4"), restore(FitConfig, told), tmp_path)
    assert checkpoint.open_model(tmp_path) is not None


def test_a_wrong_share_is_told_in_one_line() -> None:
    with pytest.raises((DataError, UsageError), match=r"--virtual-views 1.*a share from 0 to below 1"):
        config(1, virtual_views=1.0)


def test_frames_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is drawn LAPS times; then frames and virtual views take turns, and the prior pulls as much."""
    monkeypatch.setattr(model_of_splats, "LAPS", 2)
    scene, settings = corridor("4"), config(20, virtual_views=0.5)
    model = fields.family("splat").start(scene, settings, "cpu")
    assert isinstance(model, SplatModel)
    shots = [shot_at(model, scene, settings, step) for step in range(2 * len(scene.train) + 6)]
    first, later = shots[: 2 * len(scene.train)], shots[2 * len(scene.train) :]
    assert sorted(shot.position for shot in first if shot.position is not None) == sorted(2 * scene.train)
    assert [shot.position is None for shot in later] == 3 * [False, True]
    assert {shot.share for shot in first} == {1.0} and {shot.share for shot in later[::2]} == {0.5}


@pytest.mark.usefixtures("at_once")
def test_frames_come_last() -> None:
    """What the warp shows is softer than they are."""
    scene, settings = corridor("4"), config(20, virtual_views=0.5)
    model = fields.family("splat").start(scene, settings, "cpu")
    assert isinstance(model, SplatModel)
    late = [shot_at(model, scene, settings, step, 0.7) for step in range(4)]
    assert all(shot.position is not None and shot.share == 1 for shot in late)
    assert shot_at(model, scene, settings, 1, 0.69).position is None


def test_short_ways_have_no_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """The corridor's frames are 0.5 m apart; its usual depth is about 8 m."""
    scene = corridor("4")
    depth_m = virtual.usual_depth_m(scene)
    lengths = [virtual.length_m(way, scene) for way in ways(scene.train, scene)]
    monkeypatch.setattr(virtual, "LONG", (max(lengths) + min(lengths)) / 2 / depth_m)
    some = VirtualViews(scene, CPU)
    assert 0 < some.share < 1 and len(some.places) == (PARTS - 1) * round(some.share * len(lengths))
    monkeypatch.setattr(virtual, "LONG", 2 * max(lengths) / depth_m)
    monkeypatch.setattr(model_of_splats, "LAPS", 0)
    assert VirtualViews(scene, CPU).places == []
    model, settings = fields.family("splat").start(scene, config(4), "cpu"), config(4)
    assert isinstance(model, SplatModel)
    assert [shot_at(model, scene, settings, step).share for step in range(4)] == 4 * [1.0]
