"""`priors bench`: entrants in turn on the same frames, figures as `priors eval` has them, and a bench that goes on."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_folder, write_odometry

from cli.console import guarded
from cli.priors import bench as command
from cli.priors import report
from eval.calibration import Tolerance, calibration_error
from eval.protocol import preset
from eval.result import Comparison, score
from priors import build, codecs
from priors.bench import scout as scouts
from priors.bench.baselines import Sgbm
from priors.bench.entrants import Entrant
from priors.bench.judge import judge
from priors.bench.race import Race
from priors.bench.results import Bench, of_drive
from priors.bench.scout import Scouted
from priors.bench.table import lay_out, scatter
from priors.drives import open_drive
from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import Depth, Drive, Frame, Input, Method

pytestmark = pytest.mark.stress
UNCAPPED = preset("uncapped")
Run = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Shifted(Method):
    """The truth, a share too far; sure of it by a half."""

    share: float = 0.1
    fails_at: str = ""

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("truth",)

    @property
    def sure_within(self) -> Tolerance:
        return Tolerance(0.05, "share")

    def resolve(self, frame: Frame) -> "Shifted":
        return self

    def __call__(self, frame: Frame) -> Depth:
        if frame.id == self.fails_at:
            raise DataError(f"frame {frame.id}: it fails here")
        depth_m = frame.truth().depth_m * np.float32(1 + self.share)
        return Depth(depth_m, np.where(depth_m > 0, np.float32(0.5), 0))


def lineup(**more: Method) -> list[Entrant]:
    methods = {"near": Shifted(0.01), "far": Shifted(0.1)} | more
    return [Entrant(name, method) for name, method in methods.items()]


def at_once(method: Method, drive: Any, frame: int, timeout_s: float | None) -> Scouted:
    """A scout that needs no process of its own."""
    return Scouted(0.01, 0.01, 0.01, 0.5)


def race(drive: Drive, folder: Path, entrants: list[Entrant] | None = None, **more: Any) -> Race:
    options = {"scout": at_once} | more
    return Race(judge(drive, range(len(drive)), 12, UNCAPPED, None), entrants or lineup(), folder / "bench", **options)


@pytest.fixture
def drive(tmp_path: Path) -> Drive:
    return open_drive(write_folder(tmp_path / "mine", ("a", "b", "c", "d")))


def test_figures_are_those_of_priors_eval(drive: Drive, tmp_path: Path) -> None:
    bench = race(drive, tmp_path).run(race(drive, tmp_path).enter())
    near, far = bench.standings
    frames = [drive[index] for index in range(4)]
    maps = [Shifted(0.1)(frame) for frame in frames]
    compared = [
        Comparison(f.id, made.depth_m, made.confidence, f.truth().depth_m) for f, made in zip(frames, maps, strict=True)
    ]
    wanted = score(compared, UNCAPPED).metrics("image")
    found = far.metrics()
    assert {key: found[key] for key in wanted} == pytest.approx(wanted, nan_ok=True)
    assert found["abs_rel"] == pytest.approx(0.1, abs=1e-3)
    assert (near.metrics()["calibration"], found["calibration"]) == (0.5, 0.5)  # says a half; all right, and all wrong
    assert [trial.frame for trial in near.trials] == list(drive.ids)
    assert near.peak_gib == 0.5 and near.seconds > 0 and 0 < near.trials[0].read_s <= near.trials[0].seconds


def test_entrants_take_turns_from_frame_to_frame(drive: Drive, tmp_path: Path) -> None:
    names: list[str] = []
    race(drive, tmp_path).run(race(drive, tmp_path).enter(), names.append)
    assert names == ["near", "far"] * 4


def test_a_bench_that_was_stopped_goes_on(drive: Drive, tmp_path: Path) -> None:
    names: list[str] = []

    def stop(name: str) -> None:
        names.append(name)
        if len(names) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        race(drive, tmp_path).run(race(drive, tmp_path).enter(), stop)
    kept = Bench.load(tmp_path / "bench")
    assert [len(each.trials) for each in kept.standings] == [2, 2]  # whole rounds
    again = race(drive, tmp_path, scout=None)  # nobody is scouted again
    entered = again.enter()
    assert entered.plan.frames == {"near": 2, "far": 2}
    bench = again.run(entered)
    assert [len(each.trials) for each in bench.standings] == [4, 4]
    assert bench.standings[0].trials[:2] == kept.standings[0].trials
    assert not race(drive, tmp_path).enter().plan.frames


def test_what_was_measured_otherwise_is_measured_again(drive: Drive, tmp_path: Path) -> None:
    first = race(drive, tmp_path)
    first.run(first.enter())
    for other in (
        replace(first, judge=judge(drive, range(len(drive)), 2, UNCAPPED, None)),
        replace(first, judge=judge(drive, range(len(drive)), 12, preset("paper"), None)),
        replace(first, entrants=lineup(near=Shifted(0.02))[:1]),
    ):
        assert other.enter().plan.frames["near"] == len(other.judge.frames)


def test_who_does_not_take_part_this_time_is_kept(drive: Drive, tmp_path: Path) -> None:
    race(drive, tmp_path).run(race(drive, tmp_path).enter())
    one = race(drive, tmp_path, lineup()[:1])
    assert len(one.run(one.enter()).standings) == 1
    assert [each.name for each in Bench.load(tmp_path / "bench").standings] == ["near", "far"]


def test_who_cannot_work_says_why_and_the_others_go_on(drive: Drive, tmp_path: Path) -> None:
    entrants = [*lineup(fails=Shifted(0.3, fails_at="b")), Entrant("lidar", Lidar())]
    made = race(drive, tmp_path, entrants)
    bench = made.run(made.enter())
    by_name = {each.name: each for each in bench.standings}
    assert "it fails here" in by_name["fails"].error and not by_name["lidar"].trials
    assert len(by_name["near"].trials) == 4
    notes = "\n".join(lay_out(bench).notes)
    assert "without lidar" in notes and "without fails" in notes
    with pytest.raises(DataError, match="no entrant can work"):
        race(drive, tmp_path / "other", [Entrant("lidar", Lidar())]).enter()


def test_a_slow_one_makes_fewer_maps(drive: Drive, tmp_path: Path) -> None:
    def scout(method: Method, *_: Any) -> Scouted:
        return Scouted(0, 3.0 if method == Shifted(0.1) else 0.01, 0)

    made = race(drive, tmp_path, limit_s=8.0, scout=scout)
    entered = made.enter()
    assert entered.plan.shortened == ("far",) and entered.plan.frames == {"near": 4, "far": 2}
    assert "on fewer frames: far 2" in lay_out(made.run(entered)).notes


def test_the_front_is_marked_and_drawn(drive: Drive, tmp_path: Path) -> None:
    made = race(drive, tmp_path, lineup(best=Shifted(0.0)))
    bench = made.run(made.enter())
    seconds = {"near": 0.2, "far": 0.3, "best": 0.4}
    for each in bench.standings:
        each.trials[:] = [replace(trial, seconds=seconds[each.name]) for trial in each.trials]
    assert [name for (name,) in lay_out(bench).names] == ["* near", "far", "* best"]
    drawn = scatter(bench)
    assert drawn is not None and [dot.on_front for dot in drawn.dots] == [True, False, True]


def test_a_scout_tells_time_and_memory_of_a_process_of_its_own(drive: Drive) -> None:
    found = scouts.send(Sgbm(), drive, 0)
    assert not found.error and 0.02 < found.peak_gib < 4 and 0 < found.warm_s < 60
    assert "sweep" in scouts.send(Lidar(), drive, 0).error or "LiDAR" in scouts.send(Lidar(), drive, 0).error


def test_a_scout_that_takes_too_long_is_given_up(drive: Drive) -> None:
    assert "made no map in" in scouts.send(Sgbm(), drive, 0, 0.01).error


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run `priors bench` in a folder of its own; returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "Race", lambda *args: Race(*args, scout=at_once))

    def call(*arguments: str, what: object = command) -> tuple[int, str, str]:
        code = guarded(lambda: what.run(list(arguments)))  # type: ignore[attr-defined]
        done = capsys.readouterr()
        return code, done.out, done.err

    return call


def test_the_command_writes_a_table_a_plot_and_a_chapter(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", ("a", "b", "c"))
    code, out, err = run("mine", "--only", "SGBM", "--count", "2")
    assert code == 0, err
    home = tmp_path / "cache/mine/bench"
    assert {path.name for path in home.iterdir()} == {"bench.json", "bench.md", "bench.svg", "bench.png"}
    assert "SGBM half" in out and "2 frames of 240x96" in out and "AbsRel" in out
    assert "priors bench mine --only SGBM" in (home / "bench.md").read_text()
    drive = open_drive(tmp_path / "mine")
    found = of_drive(home.parent, drive.fingerprint())
    assert found is not None and of_drive(home.parent, "other") is None
    build.prepare(drive, Stereo()).run()
    assert run("cache", what=report)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert "Run time against error of mine" in page and "AbsRel over time a frame" in page


def test_one_frame_is_enough(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", ("a",))
    code, out, _ = run("mine", "--only", "SGBM")
    assert code == 0 and "1 frame of 240x96" in out


def test_without_truth_times_can_be_had(run: Run, tmp_path: Path) -> None:
    write_odometry(tmp_path / "odometry", grey_only=True)
    told = run("odometry", "--drive", "06", "--only", "SGBM")
    assert told[0] == 1 and told[2].count("error:") == 1 and "--times-only" in told[2] and "--against" in told[2]
    code, out, _ = run("odometry", "--drive", "06", "--only", "SGBM", "--times-only")
    assert code == 0 and "times alone" in out and "AbsRel" not in out
    assert not (tmp_path / "cache/06/bench/bench.svg").exists()


def test_a_prior_can_stand_for_the_truth(run: Run, tmp_path: Path) -> None:
    drive = open_drive(write_folder(tmp_path / "mine"))
    prior = build.prepare(drive, Stereo()).run().prior
    shutil.rmtree(tmp_path / "mine/depth")
    code, out, err = run("mine", "--only", "SGBM", "--against", str(prior.folder))
    assert code == 0 and "AbsRel" in out, err
    against_itself = [command._is_itself(Entrant("", method), prior) for method in (Stereo(), Stereo("cfnet"), Sgbm())]
    assert against_itself == [True, False, False]


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("--only", "nothing"), 2, "expected how a name begins: completion, lidar"),
        (("--only", "stereo psm"), 2, "no entrant's name begins so; there are SGBM"),
        (("--count", "0"), 2, "--count"),
        (("--at-most", "fast"), 2, "--at-most fast: expected a number and s, m or h"),
        (("--network", "none.onnx"), 1, "no such file"),
        (("--psmnet", "a.py", "b.tar"), 1, "--psmnet"),
        (("--frames", "9:10"), 2, "no frames there"),
        (("--against", "nowhere"), 1, "no such folder"),
        (("--times-only", "--against", "x"), 2, "nothing is scored with --times-only"),
    ],
)
def test_wrong_wishes_are_a_line(run: Run, tmp_path: Path, arguments: tuple[str, ...], code: int, told: str) -> None:
    write_folder(tmp_path / "mine", ("0", "1"))
    done = run("mine", *arguments)
    assert done[0] == code and told in done[2] and done[2].count("error:") == 1 and "Traceback" not in done[2]


def test_truth_of_another_size_is_a_line(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", ("a",))
    codecs.write_depth_png(tmp_path / "mine/depth/a.png", np.full((48, 120), 5, np.float32))
    code, _, err = run("mine", "--only", "SGBM")
    assert code == 1 and "120x48" in err and "240x96" in err and err.count("error:") == 1


def test_a_damaged_bench_is_told_or_made_anew(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", ("a",))
    file = tmp_path / "cache/mine/bench/bench.json"
    file.parent.mkdir(parents=True)
    for content in ("", "[]", json.dumps({"format": 99})):
        file.write_text(content)
        with pytest.raises(DataError, match=r"priors bench|make it again"):
            Bench.load(file.parent)
    assert run("mine", "--only", "SGBM half")[0] == 0
    assert len(Bench.load(file.parent).standings) == 1


def test_a_figure_that_is_none_is_null(drive: Drive, tmp_path: Path) -> None:
    made = race(drive, tmp_path, scout=lambda *_: Scouted(0, 0, 0, math.nan))
    made.run(made.enter())
    assert "NaN" not in (tmp_path / "bench/bench.json").read_text()
    assert math.isnan(Bench.load(tmp_path / "bench").standings[0].peak_gib)
    assert calibration_error(np.array([1.0, 0.0]), np.array([True, False])) == 0
