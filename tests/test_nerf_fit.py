"""Fits: they learn, resume bit for bit, and say in one line what cannot work. On a small analytic corridor."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import FullDisk

from nerf import checkpoint, fields
from nerf.asked import RunConfig
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.losses import LossConfig
from nerf.run import claim, open_run
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from nerf.space import Space
from nerf.split import split
from nerf.volumetric import VolumetricFamily
from priors.errors import DataError
from priors.filters import Filters
from priors.geometry import rays as pixel_rays
from priors.records import restore
from priors.types import Camera

SIZE = (24, 64)
TRAINED = [name for name in fields.names() if isinstance(fields.family(name), VolumetricFamily)]
CAMERA = Camera(np.array([[40.0, 0, 31.5], [0, 40.0, 11.5], [0, 0, 1]]), SIZE)


def corridor(views: str = "dense", prior: bool = True, count: int = 20) -> Scene:
    """Walls at x = -4 and 4, a floor at y = 1.5, an end at z = 40, sky above 3 m; painted by place."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = 0.5 * np.arange(count)
    images = np.zeros((count, *SIZE, 3), np.uint8)
    depth_m = np.zeros((count, *SIZE), np.float32)
    directions = pixel_rays(CAMERA)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, pose in enumerate(poses):
            walls = 4 / np.abs(directions[..., 0])
            floor = np.where(directions[..., 1] > 0, 1.5 / directions[..., 1], np.inf)
            depth = np.minimum(np.minimum(walls, floor), 40 - pose[2, 3])
            place = directions * depth[..., None] + pose[:3, 3]
            sky = place[..., 1] < -3
            paint = 0.5 + 0.4 * np.sin(place @ np.array([[1.0, 0.7, 0.3], [0.5, 1.1, 0.8], [0.6, 0.4, 0.9]]))
            paint[sky] = (0.6, 0.8, 1.0)
            images[i] = np.rint(255 * paint)
            depth_m[i] = np.where(sky, 0, depth)
    train, test = split(count, views)
    ids = [f"{i:06d}" for i in range(count)]
    return Scene("corridor", ids, CAMERA, poses, images, depth_m if prior else None, None, train, test)


def config(steps: int = 60, family: str = "ngp", **losses: object) -> FitConfig:
    model = ModelConfig(family=family, log2_size=14, finest=256, width=16, sampler=SamplerConfig(render=96))
    rules = replace(LossConfig(loss="l1"), **losses)  # type: ignore[arg-type]
    return FitConfig(model=model, losses=rules, rays=512, steps=steps, seconds=None)


def held_out(scene: Scene, run: Path) -> tuple[float, float]:
    """Return PSNR and AbsRel of the first held-out view."""
    position = scene.test[0]
    view = checkpoint.open_model(run).render(scene.T_world_cam[position], scene.camera)
    psnr = -10 * np.log10(np.mean((view.rgb - scene.images[position] / 255) ** 2))
    truth_m = corridor().depth_m[position]  # type: ignore[index]
    seen = truth_m > 0
    return float(psnr), float(np.mean(np.abs(view.depth_m - truth_m)[seen] / truth_m[seen]))


@pytest.mark.slow
@pytest.mark.parametrize("family", TRAINED)
def test_every_family_learns_colour_and_depth(tmp_path: Path, family: str) -> None:
    scene = corridor()
    seen: list[Status] = []
    fit(scene, config(150, family), tmp_path, seen.append)
    psnr, abs_rel = held_out(scene, tmp_path)
    assert psnr > 17
    assert abs_rel < 0.12
    assert seen[-1].loss < 0.5 * seen[0].loss
    assert seen[-1].progress == 1


@pytest.mark.slow
def test_a_prior_helps_where_views_are_few(tmp_path: Path) -> None:
    for prior in (True, False):
        fit(corridor("4", prior), config(150), tmp_path / str(prior))
    with_, without = (held_out(corridor("4"), tmp_path / str(prior)) for prior in (True, False))
    assert with_[1] < 0.5 * without[1]


@pytest.mark.parametrize(
    ("family", "prior", "growth", "grown"),
    [
        ("ngp", True, None, [64, 92, 128, 180]),
        ("nerfpp", True, None, [64, 92, 128, 180]),
        ("ngp", False, None, [64] * 4),
        ("mip360", True, None, [64] * 4),
        ("mip360", False, 16.0, [64, 128, 256, 512]),
        ("ngp", True, 1.0, [64] * 4),
    ],
)
def test_batches_grow_as_the_family_or_the_user_has_it(
    tmp_path: Path, family: str, prior: bool, growth: float | None, grown: list[int]
) -> None:
    seen: list[Status] = []
    fit(corridor(prior=prior), replace(config(4, family), rays=64, rays_growth=growth), tmp_path, seen.append)
    assert [status.rays for status in seen] == grown


@pytest.mark.parametrize("guessed", [True, False])
def test_doubtful_values_count_by_precision_where_they_are_guesses(tmp_path: Path, guessed: bool) -> None:
    """The same bits as where the user says it, and other ones than the other way."""
    scene = corridor()
    trust = np.random.default_rng(0).integers(0, 255, scene.images.shape[:3]).astype(np.uint8)
    scene = replace(scene, weight=trust, guessed=guessed)
    ways = {
        weigh: fit(scene, config(3, weigh=weigh), tmp_path / weigh) for weigh in ("auto", "precision", "confidence")
    }
    table = {weigh: model.parameters()["field.grid"] for weigh, model in ways.items()}
    assert torch.equal(table["auto"], table["precision"]) == guessed
    assert torch.equal(table["auto"], table["confidence"]) != guessed


@pytest.mark.parametrize("family", TRAINED)
def test_a_resumed_run_ends_in_the_same_bits(tmp_path: Path, family: str) -> None:
    scene = corridor("sparse")
    whole = fit(scene, config(40, family), tmp_path / "whole")

    class Killed(Exception):
        pass

    def kill(status: Status) -> None:
        if status.step == 17:
            raise Killed

    with pytest.raises(Killed):
        fit(scene, config(40, family), tmp_path / "parts", kill)
    parts = fit(scene, config(40, family), tmp_path / "parts")
    for name, tensor in whole.parameters().items():
        assert torch.equal(tensor, parts.parameters()[name]), name
    assert torch.equal(whole.occupancy.kept, parts.occupancy.kept)


@pytest.mark.parametrize("family", ["ngp", "mip360", "nerfpp"])
def test_a_prior_does_not_move_the_space(family: str) -> None:
    scene, start = corridor("sparse"), fields.family(family).start
    assert scene.depth_m is not None
    rng = np.random.default_rng(5)
    wrong = np.where(rng.random(scene.depth_m.shape) < 0.3, 10 * scene.depth_m, scene.depth_m).astype(np.float32)
    near = np.where(scene.depth_m < 6, scene.depth_m, 0)
    thin = np.where(rng.random(scene.depth_m.shape) < 0.01, scene.depth_m, 0)
    model = replace(config(family=family).model, sampler=SamplerConfig(carve=False))
    settings = replace(config(), model=model)
    maps = (scene.depth_m, wrong, near, thin, None)
    laid = {start(replace(scene, depth_m=each), settings, "cpu").space for each in maps}
    assert len(laid) == 1


@pytest.mark.parametrize("family", ["ngp", pytest.param("nerfpp", marks=pytest.mark.slow)])
def test_a_fit_guides_fewer_rays_as_it_goes_on(family: str) -> None:
    scene = corridor("sparse")
    start = fields.family(family).start

    def samples(progress: float, **sampler: object) -> int:
        settings = config(family=family)
        rules = replace(settings.model.sampler, unguided=0.0, carve=False, **sampler)  # type: ignore[arg-type]
        settings = replace(settings, model=replace(settings.model, sampler=rules))
        return start(scene, settings, "cpu").train(scene, settings, 1, progress).samples

    assert samples(0.5, unguided_later=1.0) == samples(0.5, guide=False) != samples(0.5, unguided_later=0.0)
    assert samples(0.0, unguided_later=1.0) == samples(0.0, unguided_later=0.0)


def test_a_run_goes_on_in_the_space_that_it_was_begun_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An earlier version laid a box around the prior; its runs end in the bits in which they would have ended then."""
    scene, short = corridor("sparse"), 5
    recorded = {"kind": "box", "centre_m": [0.1, 0.2, 14.7], "half_m": [5.3, 4.0, 21.1], "near_m": 0.31, "far_m": 71.9}
    with monkeypatch.context() as then:
        then.setattr(Space, "along", classmethod(lambda cls, poses, kind: restore(Space, recorded)))
        whole = fit(scene, config(2 * short), tmp_path / "whole")

        def kill(status: Status) -> None:
            if status.step == short:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fit(scene, config(2 * short), tmp_path / "parts", kill)
    parts = fit(scene, config(2 * short), tmp_path / "parts")
    assert parts.space == whole.space != Space.along(scene.T_world_cam, "cube")
    assert parts.space.detail == 1 and parts.space.knee_m == 5.3, "what earlier versions did is what a record lacks"
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, parts.state()[name]), name


def test_another_seed_ends_elsewhere(tmp_path: Path) -> None:
    scene = corridor("sparse")
    one, two = (fit(scene, replace(config(5), seed=seed), tmp_path / str(seed)) for seed in (0, 1))
    assert not torch.equal(one.parameters()["field.grid"], two.parameters()["field.grid"])


def test_a_finished_run_is_not_trained_again(tmp_path: Path) -> None:
    fit(corridor(), config(5), tmp_path)
    seen: list[Status] = []
    fit(corridor(), config(5), tmp_path, seen.append)
    assert seen == []
    assert checkpoint.spent(tmp_path).step == 5
    assert checkpoint.spent(tmp_path / "none").step == 0


def test_a_larger_budget_goes_on(tmp_path: Path) -> None:
    fit(corridor(), config(5), tmp_path)
    seen: list[Status] = []
    fit(corridor(), config(8), tmp_path, seen.append)
    assert [status.step for status in seen] == [6, 7, 8]


def test_losses_are_logged(tmp_path: Path) -> None:
    fit(corridor(), config(40), tmp_path)
    assert len((tmp_path / "metrics.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize("loss", ["mse", "l1", "kl", "urf"])
def test_bad_depth_values_do_no_harm(tmp_path: Path, loss: str) -> None:
    scene = corridor("sparse")
    assert scene.depth_m is not None
    depth_m = scene.depth_m.copy()
    depth_m[:, ::3] = np.nan
    depth_m[:, 1::3, ::2] = np.inf
    depth_m[:, 2::3, :4] = -5
    model = fit(replace(scene, depth_m=depth_m), config(10, loss=loss), tmp_path)
    assert all(torch.isfinite(tensor).all() for tensor in model.parameters().values())


def test_one_view_is_enough_to_run(tmp_path: Path) -> None:
    model = fit(corridor("1"), config(10), tmp_path)
    assert all(torch.isfinite(tensor).all() for tensor in model.parameters().values())


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path, full_disk: FullDisk) -> None:
    fit(corridor(), config(5), tmp_path)
    before = checkpoint.digest(tmp_path)
    with full_disk(100_000), pytest.raises(OSError) as told:
        fit(corridor(), config(8), tmp_path)
    assert told.value.filename == str(tmp_path / checkpoint.NAME)
    assert checkpoint.digest(tmp_path) == before
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("damage", ["cut", "text"])
def test_a_damaged_checkpoint_is_named(tmp_path: Path, damage: str) -> None:
    fit(corridor(), config(3), tmp_path)
    path = tmp_path / checkpoint.NAME
    path.write_bytes(path.read_bytes()[:5000] if damage == "cut" else b"hello")
    with pytest.raises(DataError, match="damaged checkpoint"):
        fit(corridor(), config(6), tmp_path)


def test_other_settings_do_not_continue_a_run(tmp_path: Path) -> None:
    fit(corridor(), config(3), tmp_path)
    wider = config(6)
    with pytest.raises(DataError, match="other settings"):
        fit(corridor(), replace(wider, model=replace(wider.model, width=32)), tmp_path)


def test_a_run_is_read_back_and_kept_apart(tmp_path: Path) -> None:
    asked = RunConfig({"dataset": "x", "path": "/y"}, None, "0:9", "sparse", Filters(clip=40.0), config())
    claim(tmp_path, asked)
    assert open_run(tmp_path).config == asked
    claim(tmp_path, replace(asked, fit=replace(asked.fit, steps=99)))
    claim(tmp_path, replace(asked, views="dense"))
    claim(tmp_path, asked)
    kept = tmp_path / checkpoint.NAME
    kept.write_bytes(b"trained")
    with pytest.raises(DataError, match="other settings"):
        claim(tmp_path, replace(asked, views="dense"))
    claim(tmp_path, replace(asked, fit=replace(asked.fit, steps=50)))
    claim(tmp_path, replace(asked, fit=replace(asked.fit, steps=50)), same_budget=True)
    assert kept.exists()
    claim(tmp_path, replace(asked, fit=replace(asked.fit, steps=99)), same_budget=True)
    assert not kept.exists()
    record = json.loads((tmp_path / "config.json").read_text())
    del record["fit"]["losses"]["distortion"]
    (tmp_path / "config.json").write_text(json.dumps(record))
    assert open_run(tmp_path).config.fit.losses.distortion == LossConfig().distortion, "an earlier version's run"
    (tmp_path / "config.json").write_text(json.dumps(record | {"novel": 1}))
    with pytest.raises(DataError, match="novel is not known"):
        open_run(tmp_path)
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(DataError, match="damaged"):
        open_run(tmp_path)
