"""A loss that is no number stops a fit, its cause is named, and the last good checkpoint stays."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_nerf_fit import config, corridor

from nerf import checkpoint, finite, journal, keeper
from nerf.checkpoint import Spent
from nerf.config import FitConfig
from nerf.fit import Status, fit
from nerf.keeper import Keeper, LostError
from nerf.losses import LossConfig
from nerf.model import StepResult
from nerf.optimise import OptimiserConfig
from nerf.scene import Scene


def broken(what: str) -> Scene:
    """The corridor with one frame that cannot be right."""
    scene = corridor("sparse")
    position = scene.train[1]
    assert isinstance(scene.depth_m, np.ndarray)
    if what == "pose":
        scene.T_world_cam[position, 0, 3] = np.nan
    elif what == "rotation":
        scene.T_world_cam[position, :3, :3] *= 1e30
    elif what == "image":
        images = scene.images.astype(np.float32)
        images[position] = np.nan
        return replace(scene, images=images)
    elif what == "confidence":
        weight = np.full(scene.depth_m.shape, 255, np.float32)
        weight[position] = np.nan
        return replace(scene, weight=weight)
    elif what == "depth":
        scene.depth_m[position, ::2] = 1e30
    return scene


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("pose", "its pose is not finite"),
        ("rotation", "its pose is no rotation"),
        ("image", "its image holds values that are not finite"),
        ("confidence", "its prior's confidence is not finite"),
        ("depth", "its prior has depths up to 1e+30 m"),
    ],
)
def test_the_frame_is_named(what: str, told: str) -> None:
    scene = broken(what)
    assert finite.cause(scene, config()).startswith(f"frame {scene.ids[scene.train[1]]}: {told}")


def test_the_camera_is_named() -> None:
    scene = corridor("sparse")
    camera = replace(scene.camera, K=np.array([[np.nan, 0, 31.5], [0, 40.0, 11.5], [0, 0, 1]]))
    assert finite.cause(replace(scene, camera=camera), config()).startswith("the camera matrix is not finite")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"losses": LossConfig(depth_weight=1e30)}, "--depth-weight 1e+30 is far from the usual 0.05"),
        ({"losses": LossConfig(unit_m=1e-30, distortion=1)}, "--unit-m 1e-30 is far from the usual 16"),
        ({"losses": LossConfig(sigma_floor_m=1e-30)}, "--sigma-floor-m 1e-30 is far"),
        ({"optimiser": OptimiserConfig(grid=1e9)}, "optimiser.grid 1e+09 is far from the usual 0.01"),
        ({"optimiser": OptimiserConfig(sky=10 * OptimiserConfig().sky)}, "optimiser.sky"),
        ({}, "no input and no setting stands out"),
    ],
)
def test_the_setting_is_named(changes: dict[str, Any], told: str) -> None:
    assert finite.cause(corridor("sparse"), FitConfig(**changes)).startswith(told)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_ten_times_the_rates_are_finite_or_named(tmp_path: Path, seed: int) -> None:
    usual = OptimiserConfig()
    fast = OptimiserConfig(grid=10 * usual.grid, network=10 * usual.network, sky=10 * usual.sky)
    try:
        model = fit(corridor("sparse"), replace(config(60), seed=seed, optimiser=fast), tmp_path)
    except finite.NotFiniteError as error:
        assert "optimiser" in str(error)
        return
    assert finite.bad_tensor(model.state()) is None


def test_a_fit_stops_at_once_and_keeps_what_was_good(tmp_path: Path) -> None:
    fit(corridor("sparse"), config(5), tmp_path)
    good = checkpoint.digest(tmp_path)
    seen: list[Status] = []
    with pytest.raises(finite.NotFiniteError) as told:
        fit(broken("image"), config(400), tmp_path, seen.append)
    assert len(seen) < 60
    assert f"the loss is not finite at step {6 + len(seen)} (" in str(told.value)
    assert "image holds values that are not finite" in str(told.value)
    assert str(told.value).endswith("the checkpoint of step 5 is kept")
    assert checkpoint.digest(tmp_path) == good
    lines = [json.loads(line) for line in (tmp_path / journal.NAME).read_text().splitlines()]
    assert all(np.isfinite(line["loss"]) for line in lines)


@pytest.mark.parametrize(
    "losses", [{"loss": "mse", "depth_weight": 3e38, "unit_m": 0.1}, {"loss": "mse", "unit_m": 1e-25}]
)
def test_a_setting_that_overflows_never_leaves_a_bad_checkpoint(tmp_path: Path, losses: dict[str, Any]) -> None:
    name = next(name for name in losses if name != "loss")
    with pytest.raises(finite.NotFiniteError, match=f"--{name.replace('_', '-')} .*; nothing was kept"):
        fit(corridor("sparse"), config(3, **losses), tmp_path)
    assert not (tmp_path / checkpoint.NAME).exists()


def test_every_loss_is_looked_at() -> None:
    fine, nan = torch.tensor(1.0), torch.tensor(float("nan"))
    assert finite.bad_terms(StepResult({"rgb": fine}, fine, 1, 1)) == {}
    found = finite.bad_terms(StepResult({"rgb": fine, "interlevel": nan}, torch.tensor(float("inf")), 1, 1))
    assert list(found) == ["interlevel", "sum"]
    state = {"steps": torch.tensor(3), "a": torch.zeros(2), "b": torch.tensor([0.0, float("-inf")])}
    assert finite.bad_tensor(state) == "b"
    state["b"] = torch.tensor([float("inf"), float("-inf")])
    assert finite.bad_tensor(state) == "b"
    state["b"] = torch.full((9,), 3e38)  # finite, though their sum is not
    assert finite.bad_tensor(state) is None


class Clock:
    """Stands in for time: each look at it is a second later."""

    now_s = 0.0

    def perf_counter(self) -> float:
        self.now_s += 1
        return self.now_s


class Tensors:
    """Stands in for a model: what a keeper asks of it."""

    def __init__(self, value: float = 0.0) -> None:
        self.value = value

    def state(self) -> dict[str, torch.Tensor]:
        return {"a": torch.tensor([self.value])}


def kept_steps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    kept: list[int] = []
    monkeypatch.setattr(keeper, "save", lambda run, model, spent, origin_m: kept.append(spent.step))
    return kept


def test_the_first_checkpoint_comes_within_5_s_and_the_next_after_30(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeper, "time", Clock())
    kept = kept_steps(monkeypatch)
    one = Keeper(tmp_path, Tensors(), (0, 0, 0), Spent())  # type: ignore[arg-type]
    for second in range(1, 70):  # a step a second
        one.keep_if_due(Spent(second, float(second)))
    assert 1 < kept[0] <= 5
    assert 28 <= kept[1] - kept[0] <= 31 and len(kept) == 3


def test_what_is_bad_or_no_longer_ours_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = kept_steps(monkeypatch)
    with pytest.raises(LostError, match="another process took this run over"):
        Keeper(tmp_path, Tensors(), (0, 0, 0), Spent(), lambda: True).keep(Spent(1))  # type: ignore[arg-type]
    with pytest.raises(finite.NotFiniteError, match="a is not finite after step 1"):
        Keeper(tmp_path, Tensors(np.nan), (0, 0, 0), Spent()).keep(Spent(1))  # type: ignore[arg-type]
    Keeper(tmp_path, Tensors(), (0, 0, 0), Spent(1)).keep(Spent(1))  # type: ignore[arg-type]
    assert kept == []
