"""The ablation: every switch that is on is off once, alone; its effect is the difference of two curves."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from factories import write_folder

from cli.console import guarded
from cli.nerf import bench as command
from cli.nerf.bench import BenchArguments
from nerf.bench import ablation
from nerf.bench.ablation import ALL, OFF, SWITCHES, ablated, at_time
from nerf.bench.curve import Curve, Entrant, Point
from nerf.bench.marks import Mark
from nerf.config import FitConfig
from nerf.study import NONE, RunSpec
from priors.errors import UsageError

pytestmark = pytest.mark.stress
STEREO = "cache/wall/stereo-abcdef0123"
SPEC = RunSpec("ngp", "sparse", STEREO, "l1")
MARKS = (Mark(10, "steps"), Mark(20, "steps"))
FIT = FitConfig()


def variants(spec: RunSpec, fit: FitConfig = FIT) -> list[str]:
    return [entrant.variant for entrant in ablated(spec, fit, MARKS)]


def test_every_switch_is_off_once_and_all_are_off_together() -> None:
    usual, *others = ablated(SPEC, FIT, MARKS)
    assert usual.variant == "" and usual.fit == FIT
    names = [entrant.variant.removeprefix(OFF) for entrant in others]
    assert {"guide", "carve", "carve_sky", "terminate", "roulette_samples", "sky_opacity", "trim", "align"} < set(names)
    assert names[-1] == ALL and len({entrant.name for entrant in (usual, *others)}) == len(others) + 1
    by_name = {switch.name: switch for switch in SWITCHES}
    for entrant in others[:-1]:
        assert entrant.fit == by_name[entrant.variant.removeprefix(OFF)].off(FIT) != FIT
    bare = others[-1].fit
    assert all(switch.off(bare) == bare for switch in SWITCHES if switch.name in names)


def test_a_switch_without_effect_is_left_out() -> None:
    assert OFF + "roulette_rays" not in variants(SPEC)  # off by default
    assert OFF + "roulette_proposals" not in variants(SPEC)  # ngp has no proposals
    assert OFF + "roulette_proposals" in variants(replace(SPEC, field="mip360"))
    assert OFF + "proposals_every" not in variants(replace(SPEC, field="mip360"))  # off by default
    alone = variants(RunSpec("ngp", "sparse", NONE))
    assert not {OFF + name for name in ("guide", "carve", "trim", "align")} & set(alone)
    assert OFF + "terminate" in alone
    assert variants(replace(SPEC, field="warp")) == [""]


def curve(variant: str, seed: int, points: list[tuple[int, float, float]]) -> Curve:
    """A curve of (step, processor seconds, PSNR)."""
    entrant = Entrant(replace(SPEC, seed=seed), FIT, MARKS, variant)
    made = [
        Point(Mark(step, "steps"), step, 0.0, seconds, seconds, {"psnr": psnr, "abs_rel": 1 / psnr})
        for step, seconds, psnr in points
    ]
    return Curve(entrant, made)


def test_a_change_is_at_equal_steps_and_at_equal_time() -> None:
    on, off = curve("", 0, [(10, 1, 18), (20, 2, 20)]), curve(OFF + "guide", 0, [(10, 2, 19), (20, 4, 21)])
    found = ablation.change(on, off)
    assert found["saves"] == 2.0  # twice the time a step
    assert found["psnr"] == -1.0  # worse after 20 steps ...
    assert found["psnr_time"] == 1.0  # ... and better after 2 s
    assert found["abs_rel"] == pytest.approx(1 / 20 - 1 / 21)
    assert at_time(off.points, "psnr", 3) == 20.0
    assert math.isnan(at_time(off.points, "psnr", 5)) and math.isnan(at_time(off.points, "psnr", 1))


def test_the_table_has_means_over_seeds_and_no_fit_that_failed() -> None:
    curves = [curve("", seed, [(10, 1, 18), (20, 2, 20 + seed)]) for seed in (0, 1)]
    curves += [curve(OFF + "guide", seed, [(10, 2, 19), (20, 4, 21)]) for seed in (0, 1)]
    failed = curve(OFF + "carve", 0, [])
    failed.error = "it failed"
    laid = ablation.lay_out([*curves, failed])
    assert laid.names == [("ngp", "stereo-abcdef0123", "sparse", "guide")]
    assert laid.cells[0][:2] == ["2.00", "-0.50"]


def test_budgets_have_no_curve_to_compare() -> None:
    with pytest.raises(UsageError, match="leave out --budgets"):
        BenchArguments(ablate=True, budgets=True)


def test_the_command_writes_the_ablation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_folder(tmp_path / "mine", [f"{n}" for n in range(10)])
    monkeypatch.setattr(
        ablation, "SWITCHES", tuple(each for each in SWITCHES if each.name in ("terminate", "carve_sky"))
    )
    words = [
        "mine",
        "--field",
        "ngp",
        "--ablate",
        "--steps",
        "1",
        "2",
        "--rays",
        "32",
        "--threads",
        "1",
        "--views",
        "4",
    ]
    assert guarded(lambda: command.run(words)) == 0, capsys.readouterr().err
    told = capsys.readouterr().out
    assert "equal time" in told and "terminate" in told
    assert "nerf bench mine" in (tmp_path / "bench/ablation.md").read_text()
