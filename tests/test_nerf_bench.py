"""The bench: fits stop at marks and go on bit for bit, what is done is not made again, the table says what it must."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from factories import write_raw
from safetensors.torch import load_file

from cli.nerf.bench import BenchArguments
from eval import typeset
from nerf import checkpoint
from nerf.bench import results
from nerf.bench.curve import NAME, Curve, Entrant, Point, load
from nerf.bench.lap import Lap, ReachedError
from nerf.bench.marks import READY, Mark, ascending
from nerf.bench.race import Race
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status
from nerf.forecast import WARM, Forecast
from nerf.sample import SamplerConfig
from nerf.split import HELD_OUT, split
from nerf.study import NONE, FitRunner, RunSpec
from priors import build
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.methods.lidar import Lidar

FIT = FitConfig(ModelConfig(width=16, log2_size=12, finest=128, sampler=SamplerConfig(render=8)), rays=64)
MARKS = (Mark(1, "steps"), Mark(2, "steps"))
STEREO = "cache/wall/stereo-abcdef0123"


def test_a_race_stops_at_marks_and_goes_on(tmp_path: Path) -> None:
    drive = open_drive(write_raw(tmp_path, range(10)))
    prior = build.prepare(drive, Lidar(), folder=tmp_path / "cache").run().prior
    runner, told = FitRunner(drive, FIT, device="cpu"), list[str]()
    specs = [RunSpec("ngp", "4", NONE), RunSpec("warp", "4", str(prior.folder))]
    entrants = [Entrant.of(spec, FIT, MARKS) for spec in specs]

    def race(**more: Any) -> Race:
        return Race(runner, tmp_path / "bench", [replace(each, **more) for each in entrants])

    first = race()
    forecast = first.warm_up()
    assert (forecast.fits, forecast.left) == (2, 2)
    assert forecast.training_s > 0 < forecast.scoring_s
    assert not (tmp_path / "bench" / WARM).exists()
    curves = first.run(lambda curve: told.append(f"{curve.entrant.spec.field} {curve.points[-1].mark}"))
    assert told == ["ngp 1 steps", "warp 0 steps", "ngp 2 steps"]  # in turns
    ngp, warp = curves
    assert [point.step for point in ngp.points] == [1, 2]
    assert 0 < ngp.points[0].seconds < ngp.points[1].seconds
    assert 0 < ngp.points[0].processor_s < ngp.points[1].processor_s
    assert ngp.points[0].prepared_s == ngp.points[1].prepared_s > 0
    assert [point.mark for point in warp.points] == [READY]
    assert math.isfinite(ngp.points[0].metrics["psnr"])

    undisturbed = replace(runner, fit=replace(FIT, steps=2, seconds=None)).begin(specs[0], tmp_path / "alone")
    undisturbed.fit("cpu")
    folder = tmp_path / "bench" / entrants[0].name
    ours, theirs = (load_file(path / checkpoint.NAME) for path in (folder, undisturbed.folder))
    assert all(torch.equal(tensor, theirs[name]) for name, tensor in ours.items())

    told.clear()
    assert str(race().warm_up()) == "no fit is left to do"
    again = race().run(lambda curve: told.append(curve.entrant.name))
    assert told == []
    assert again[0].points == ngp.points
    assert not race(fit=replace(FIT, rays=65)).curves[0].points  # other settings: made anew

    content = json.loads((folder / NAME).read_text())
    content["points"].pop()  # as a kill between the marks leaves it
    (folder / NAME).write_text(json.dumps(content))
    killed = race()
    assert len(killed.curves[0].points) == 1
    assert [point.step for point in killed.run()[0].points] == [1, 2]
    (ngp_again, _) = killed.curves
    assert ngp_again.points[1].metrics["psnr"] == ngp.points[1].metrics["psnr"]


def test_a_fit_that_fails_is_told_and_the_others_go_on(tmp_path: Path) -> None:
    runner = FitRunner(open_drive(write_raw(tmp_path, range(3))), FIT, device="cpu")
    race = Race(runner, tmp_path / "bench", [Entrant.of(RunSpec("ngp", "1", NONE), FIT, MARKS)])
    assert race.warm_up().left == 0
    assert "none of the 3 frames is held out" in race.curves[0].error
    assert race.run()[0].points == []
    with pytest.raises(DataError, match=r"no fit has figures; ngp-1-none-seed0-2steps: .*held out"):
        results.lay_out(race.curves)


def test_a_lap_counts_the_preparation_once_and_ends_at_its_mark() -> None:
    def status(step: int, elapsed_s: float) -> Status:
        return Status(step, elapsed_s, 0.5, {}, torch.zeros(()), 1, 1, 0.0)

    for is_first in (True, False):
        seen = list[Status]()
        lap = Lap(Mark(3.0), is_first, seen.append)
        lap(status(1, 2.9))
        with pytest.raises(ReachedError):
            lap(status(2, 3.1))
        assert lap.status == seen[-1] == status(2, 3.1)
        assert (lap.prepared_s > 0) == is_first


def curve(spec: RunSpec, *psnrs: float, variant: str = "", fails: str = "") -> Curve:
    entrant = Entrant.of(spec, FIT, (Mark(10), Mark(30)), variant)
    points = [
        Point(mark, 100, 1.0, mark.amount, 20.0, {"psnr": psnr, "abs_rel": math.nan, "ssim_uniform7": 0.5})
        for mark, psnr in zip(entrant.marks, psnrs, strict=False)
    ]
    return Curve(entrant, points, fails)


def test_the_table_has_means_spread_ceiling_and_what_the_warp_beats(tmp_path: Path) -> None:
    curves = [
        curve(RunSpec("ngp", "sparse", STEREO, "l1"), 20.0, 22.0),
        curve(RunSpec("ngp", "sparse", STEREO, "l1", seed=1), 20.0, 24.0),
        curve(RunSpec("mip360", "sparse", STEREO, "l1"), 21.0, 25.0),
        curve(RunSpec("ngp", HELD_OUT, STEREO, "l1"), 23.0, 28.0),
        curve(RunSpec("warp", "sparse", STEREO), 24.0),
        curve(RunSpec("ngp", "sparse", NONE), fails="no map"),
    ]
    laid = results.lay_out(curves, "wall")
    rows = {name[:3]: (name[5:], cells) for name, cells in zip(laid.names, laid.cells, strict=True)}
    assert rows["sparse", "30 s", "ngp"] == (("31.0", "20.0", "100"), ["23.00", "1.41", "0.500", "-"])
    assert list(rows)[:3] == [("sparse", "-", "warp"), ("sparse", "10 s", "ngp"), ("sparse", "10 s", "mip360")]
    assert "ceiling of ngp stereo-abcdef0123: 28.00 dB on the views that it was trained on" in laid.notes
    (below,) = (line for line in laid.notes if line.startswith("no better"))
    assert "(24.00 dB, sparse views): ngp stereo-abcdef0123 (23.00)" in below
    assert "mip360" not in below
    assert any(line.endswith("failed: no map") for line in laid.notes)

    files = results.save(curves, tmp_path, laid, "nerf bench wall")
    assert {path.name for path in files} == {"bench.json", "bench.md", "bench.svg", "bench.png"}
    content = json.loads((tmp_path / "bench.json").read_text())
    assert content["machine"].keys() == {"cpu", "cores", "threads"}
    assert [len(each["points"]) for each in content["curves"]] == [2, 2, 2, 2, 1, 0]
    assert content["curves"][0]["points"][0]["metrics"]["abs_rel"] is None
    assert typeset.markdown(laid) in (tmp_path / "bench.md").read_text()
    psnr, by_processor = results.plots(curves)
    assert {line.label: line.dashed for line in psnr.lines} == {
        "ngp stereo-abcdef0123, sparse": False,
        "mip360 stereo-abcdef0123, sparse": False,
        "ngp stereo-abcdef0123, held-out": True,
        "warp stereo-abcdef0123, sparse": True,
    }
    assert psnr.lines[0].y.tolist() == [20.0, 23.0]
    assert psnr.lines[3].x.tolist() == [11.0, 31.0]  # the warp is a level
    assert by_processor.lines[0].x.tolist() == [20.0, 20.0]


def test_variants_are_rows_of_their_own(tmp_path: Path) -> None:
    spec = RunSpec("ngp", "sparse", NONE)
    curves = [curve(spec, 20.0, 22.0), curve(spec, 19.0, 21.0, variant="no-guide")]
    assert {name[2] for name in results.lay_out(curves).names} == {"ngp", "ngp no-guide"}
    assert len({each.entrant.name for each in curves}) == 2


def test_a_curve_is_read_as_it_was_written(tmp_path: Path) -> None:
    made, config = curve(RunSpec("ngp", "sparse", NONE), 20.0, 22.0), {"steps": 1}
    made.save(tmp_path, config)
    read = load(tmp_path, made.entrant, config)
    assert [(point.mark, point.seconds, point.metrics["psnr"]) for point in read.points] == [
        (Mark(10), 11.0, 20.0),
        (Mark(30), 31.0, 22.0),
    ]
    assert math.isnan(read.points[0].metrics["abs_rel"])
    assert load(tmp_path, made.entrant, {"steps": 2}).points == []
    today = json.loads(json.dumps({"fit": asdict(made.entrant.config)}))
    then = json.loads(json.dumps(today))
    del then["fit"]["model"]["gaussians"]
    made.save(tmp_path, then)
    assert len(load(tmp_path, made.entrant, today).points) == 2, "made before there was such a setting"
    (tmp_path / NAME).write_text("{")
    assert load(tmp_path, made.entrant, config).points == []


def test_ceilings_learn_what_is_scored() -> None:
    assert split(30, HELD_OUT) == ([9, 19, 29], [9, 19, 29])
    with pytest.raises(DataError, match="none of 9 frames is held out"):
        split(9, HELD_OUT)


def test_what_is_asked_for_becomes_fits() -> None:
    args = BenchArguments(field=("ngp", "warp"), seed=(0, 1), at=("60s", "10s", "1m"), ceiling=True)
    assert args.marks() == (Mark(10), Mark(60))
    names = [each.name for each in args.entrants()]
    assert names == ["ngp-sparse-none-seed0-60s", "ngp-sparse-none-seed1-60s", "ngp-held-out-none-seed0-60s"]
    several = replace(args, budgets=True, ceiling=False, steps=(5, 7)).entrants()
    assert [each.name.rsplit("-", 1)[1] for each in several] == ["5steps", "7steps", "5steps", "7steps"]
    assert [each.config.steps for each in several] == [5, 7, 5, 7]
    with pytest.raises(UsageError, match="--at x: expected a number"):
        BenchArguments(at=("x",))
    with pytest.raises(UsageError, match="--at: expected one time or more"):
        ascending([])


def test_a_forecast_reads_well() -> None:
    assert str(Forecast(6, 4, 240, 60)) == "4 of 6 fits: 4.0 min of training, about 1.0 min of scoring"
    assert str(Forecast(1, 1, 60, 6)) == "1 fit: 1.0 min of training, about 0.1 min of scoring"
    assert str(Forecast(6, 6, 360, 60)) == "6 fits: 6.0 min of training, about 1.0 min of scoring"
