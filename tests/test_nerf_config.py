"""Settings check themselves when they are made, and the commands tell what is wrong in one line."""

import math
from typing import Any

import pytest

from cli.nerf import PROGRAM
from nerf.config import FitConfig, ModelConfig
from nerf.export import CloudConfig
from nerf.losses import LossConfig
from nerf.optimise import OptimiserConfig
from nerf.sample import SamplerConfig
from nerf.sky import SkyConfig
from nerf.video import VideoConfig
from priors.errors import DataError

WRONG: list[tuple[type[Any], str, list[Any]]] = [
    (SamplerConfig, "count", [1, 0, -5]),
    (SamplerConfig, "proposed", [1]),
    (SamplerConfig, "free", [0]),
    (SamplerConfig, "unguided_later", [-0.1, 1.5]),
    (SamplerConfig, "render", [0]),
    (SamplerConfig, "reach", [0.0, -3.0, math.nan, math.inf]),
    (SamplerConfig, "unguided", [-0.1, 7.0, math.nan]),
    (SamplerConfig, "trust", [-0.1, 1.1]),
    (LossConfig, "loss", ["l2", ""]),
    (LossConfig, "depth_weight", [-1.0, math.nan, math.inf]),
    (LossConfig, "unit_m", [0.0, -1.0]),
    (LossConfig, "sigma_share", [-0.1]),
    (LossConfig, "sigma_floor_m", [0.0, -1.0, math.nan]),
    (LossConfig, "trim", [-0.1, 1.0]),
    (LossConfig, "weigh", ["no", ""]),
    (LossConfig, "distortion", [-1.0]),
    (LossConfig, "opacity", [-1.0]),
    (OptimiserConfig, "grid", [-1.0, math.nan]),
    (OptimiserConfig, "warm_up", [-1]),
    (OptimiserConfig, "final", [-0.1, 2.0]),
    (ModelConfig, "width", [50, 0, 144]),
    (ModelConfig, "log2_size", [3, 25]),
    (ModelConfig, "finest", [8, 1 << 21]),
    (FitConfig, "rays", [0, -1]),
    (FitConfig, "rays_growth", [0.5, -1.0, 65.0, math.nan, math.inf]),
    (FitConfig, "steps", [0, -1]),
    (FitConfig, "seconds", [0.0, -1.0, math.nan, math.inf, None]),
    (FitConfig, "seed", [-1, 1 << 63]),
    (SkyConfig, "sizes", [(), (1, 8)]),
    (CloudConfig, "voxel_m", [0.0]),
    (VideoConfig, "steps", [0]),
]


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [pytest.param(kind, name, value, id=f"{name} {value}") for kind, name, values in WRONG for value in values],
)
def test_a_wrong_setting_is_told_with_what_was_expected(kind: type[Any], name: str, value: Any) -> None:
    with pytest.raises(DataError) as told:
        kind(**{name: value})
    message = str(told.value)
    assert "expected" in message and "\n" not in message
    flag = {"seconds": "--time"}.get(name, f"--{name.replace('_', '-')}")
    assert name in message or message.startswith(f"{flag} ")


@pytest.mark.parametrize(
    "flags",
    [
        ["--width", "50"],
        ["--rays", "0"],
        ["--rays-growth", "0.5"],
        ["--reach", "-3"],
        ["--unguided", "7"],
        ["--sigma-floor-m", "-1"],
        ["--seed", "-1"],
        ["--steps", "0"],
        ["--time", "0s"],
    ],
    ids=" ".join,
)
def test_fit_refuses_it_in_one_line_before_the_drive_is_read(
    capsys: pytest.CaptureFixture[str], flags: list[str]
) -> None:
    assert PROGRAM.run(["fit", "/nowhere", *flags]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith("error: ") and "expected" in told[0] and "nowhere" not in told[0]
