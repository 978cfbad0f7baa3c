"""How much a completion network's correction counts where samples are dense, and how that is measured."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt
from test_learn_completion import scene, street  # noqa: F401
from test_mffnet import F

from priors.learn import completion_gate
from priors.learn.completion_gate import Standing, choose
from priors.learn.lidar_dropout import Density, drop_points
from priors.methods._completion_gate import ENTRY, DensityGate, density_of
from priors.methods.completion import Completion, complete
from priors.nets import mffnet, weights

pytestmark = pytest.mark.networks
GIVEN = Standing("kitti2015_64lines", False, 0.05, 0.06, 0.7, 0.7)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Weights of a network that makes everything half as far again."""
    torch.manual_seed(0)
    net = mffnet.Mffnet("s")
    with torch.no_grad():
        net.head.bias[:8] = float(np.log(1.5))
    weights.write(tmp_path / "mine.safetensors", net, {"net": "mffnet", "size": "s"}, torch.float32)
    return tmp_path / "mine.safetensors"


@pytest.mark.parametrize(("density", "share"), [(0, 1), (0.05, 1), (0.06, 0.75), (0.08, 0.25), (0.09, 0), (1, 0)])
def test_the_share_falls_between_two_densities(density: float, share: float) -> None:
    assert DensityGate(0.05, 0.09).share(density) == pytest.approx(share)


@pytest.mark.parametrize("about", [{}, {ENTRY: None}])
def test_weights_that_were_not_measured_always_count(about: dict[str, object]) -> None:
    assert DensityGate.of(about).share(1.0) == 1


def test_density_is_of_the_pixels_that_get_a_value() -> None:
    sparse_m = np.zeros((10, 10), F)
    sparse_m[:5:2, :5] = 7
    near = np.zeros((10, 10), bool)
    near[:5] = True
    assert density_of(sparse_m, near) == 15 / 50
    assert density_of(np.zeros((10, 10), F), np.zeros((10, 10), bool)) == 0


@pytest.mark.parametrize(("gate", "power"), [(None, 1), ((1.0, 2.0), 1), ((0.0, 1e-9), 0), ("around", 0.5)])
def test_the_correction_counts_by_its_share(file: Path, gate: object, power: float) -> None:
    """Of a correction of 1.5, half the say is a factor of sqrt(1.5), and none is the fill; far off it is all of it."""
    shown = drop_points(scene(), np.random.default_rng(0), Density())
    given = shown.sparse_m, shown.scene.image, shown.scene.camera, None
    fill_m = complete(*given).depth_m
    density = np.count_nonzero(shown.sparse_m) / np.count_nonzero(fill_m)
    weights.rewrite_about(file, **{ENTRY: [density - 0.01, density + 0.01] if gate == "around" else gate})
    mended_m = Completion(model="mffnet", weights=file, runtime="fp32").fill(*given).depth_m
    near = fill_m > 0
    assert np.array_equal(mended_m > 0, near)
    inside = near & (mended_m < 0.99 * mended_m.max()) & (fill_m > 1.01 * fill_m[near].min())
    ratio, distance_px = mended_m / np.maximum(fill_m, 1e-6), distance_transform_edt(shown.sparse_m == 0)
    np.testing.assert_allclose(ratio[inside & (distance_px < 2.9)], 1.5**power, rtol=2e-3)
    np.testing.assert_allclose(ratio[inside & (distance_px > 9.5)], 1.5, rtol=2e-3)
    assert (inside & (distance_px > 9.5)).any() and (inside & (distance_px < 2.9)).any()


def test_the_gate_closes_at_the_sparsest_map_that_gets_worse() -> None:
    better = replace(GIVEN, name="drive_3sweeps", accumulated=True, density=0.1, densest=0.12, abs_rel=0.9, rmse=0.99)
    worse = replace(better, density=0.15, rmse=1.01)
    densest = replace(worse, density=0.3, abs_rel=2.0)
    assert choose([GIVEN, better, worse, densest]) == DensityGate(0.06, 0.15)
    assert choose([GIVEN, better]) is None
    assert choose([replace(GIVEN, rmse=3.0), worse]) == DensityGate(0.06, 0.15), "a single sweep is what it is for"


def test_a_file_is_measured_by_the_command(file: Path, street: Path, capsys: pytest.CaptureFixture[str]) -> None:  # noqa: F811
    from cli import priors

    weights.rewrite_about(file, **{ENTRY: [0.0, 1e-9]})
    assert priors.PROGRAM.run(["train", "calibrate", str(file), "--street", str(street)]) == 0
    told = capsys.readouterr().out
    assert "street_64lines: density" in told and "counts at every density" in told
    assert weights.read_about(file)[ENTRY] is None, "no real scene was seen"
    [line] = completion_gate.calibrate_file(file, street, None)[:1]
    assert float(line.split("AbsRel ")[1].split(",")[0]) > 1.5, "it was measured without its old gate"


def test_other_networks_are_not_calibrated(tmp_path: Path) -> None:
    from cli import priors
    from priors.nets import bts

    torch.manual_seed(0)
    weights.write(tmp_path / "mono.safetensors", bts.Bts("s"), {"net": "bts", "size": "s"})
    assert priors.PROGRAM.run(["train", "calibrate", str(tmp_path / "mono.safetensors")]) == 1
