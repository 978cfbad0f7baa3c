"""Budgets: the most accurate in the time, the fastest for the error; by the drive's own bench or the shipped table."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import cv2
import numpy as np
import pytest
from factories import write_folder
from hypothesis import given
from hypothesis import strategies as st

from cli.console import guarded
from cli.priors import build as command
from eval.protocol import preset
from priors.bench import candidates as expected
from priors.bench import shipped
from priors.bench.budget import Budget
from priors.bench.candidates import OWN, SHIPPED, Candidate, candidates, most_accurate
from priors.bench.entrants import Entrant, field_size
from priors.bench.judge import judge
from priors.bench.probe import KINDS, calibrate
from priors.bench.race import Race
from priors.bench.results import Bench, Standing, Trial
from priors.bench.searched import searched, usual
from priors.cache import find
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import Camera, Drive, Frame

pytestmark = pytest.mark.stress
Run = Callable[..., tuple[int, str, str]]
MODELS = ("classical", "cfnet", "pcwnet")
SOME = st.lists(
    st.builds(
        Candidate,
        st.sampled_from(MODELS),
        st.just(Stereo()),
        st.sampled_from([0.05, 0.1, 0.2, 0.4]),
        st.sampled_from([0.01, 0.02, 0.05, math.nan]),
        st.sampled_from([0.3, 1.0]),
        st.just(OWN),
    ),
    min_size=1,
    max_size=6,
)


@pytest.mark.parametrize(
    ("text", "seconds", "error"),
    [
        ("100ms", 0.1, None),
        ("2s", 2.0, None),
        ("1.5s", 1.5, None),
        ("absrel=0.02", None, 0.02),
        ("AbsRel=.5", None, 0.5),
    ],
)
def test_a_budget_is_a_time_or_an_error(text: str, seconds: float | None, error: float | None) -> None:
    assert Budget.parse(text) == Budget(seconds, error)


@pytest.mark.parametrize(
    "text", ["", "100", "5 parsecs", "100 ms", "0ms", "-1s", "absrel", "absrel=", "absrel=0", "rmse=1"]
)
def test_wrong_units_are_told_in_a_line(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        Budget.parse(text)
    assert str(caught.value).startswith("--budget") and "\n" not in str(caught.value)


@given(SOME, st.sampled_from([0.06, 0.15, 0.5]), st.booleans())
def test_a_time_takes_the_most_accurate_that_keeps_to_it(among: list[Candidate], seconds: float, named: bool) -> None:
    kept = [each for each in among if each.seconds <= seconds and (named or each.density >= 0.5)]
    budget = Budget(seconds=seconds)
    if not kept:
        with pytest.raises(DataError, match="--budget"):
            budget.choose(among, named)
        return
    chosen = budget.choose(among, named)
    assert chosen in kept
    errors = [each.abs_rel for each in kept if not math.isnan(each.abs_rel)]
    assert math.isnan(chosen.abs_rel) if not errors else chosen.abs_rel == min(errors)


@given(SOME, st.sampled_from([0.01, 0.02, 0.1]))
def test_an_error_takes_the_fastest_that_is_as_right(among: list[Candidate], error: float) -> None:
    kept = [each for each in among if each.abs_rel <= error and each.dense]
    if not kept:
        with pytest.raises(DataError, match="--budget"):
            Budget(abs_rel=error).choose(among)
        return
    assert Budget(abs_rel=error).choose(among).seconds == min(each.seconds for each in kept)


def test_what_nothing_meets_names_the_fastest_and_its_time() -> None:
    among = [
        Candidate("stereo", Stereo(), 0.12, 0.02, 1.0, OWN),
        Candidate("fast", Stereo("cfnet"), 0.05, 0.05, 1.0, OWN),
    ]
    with pytest.raises(DataError, match=r"the fastest is fast, 50 ms a frame.*--stereo.model cfnet"):
        Budget(seconds=0.01).choose(among)
    with pytest.raises(DataError, match=r"the best is stereo, AbsRel 0.0200, 120 ms.*the fastest is fast, 50 ms"):
        Budget(abs_rel=0.001).choose(among)
    sparse = [Candidate("lidar", Lidar(), 0.01, 0.003, 0.3, OWN)]
    with pytest.raises(DataError, match="dense"):
        Budget(seconds=1).choose(sparse)
    assert Budget(seconds=1).choose(sparse, named=True) is sparse[0]


def test_the_shipped_table_knows_every_method_of_ours_in_each_mode() -> None:
    names = {each.name for each in field_size(["auto"])}
    assert set(shipped.table()["modes"]) >= {"avx512_bf16"}
    for mode, (full, half) in shipped.table()["modes"].items():
        assert set(full["ms"]) == set(half["ms"]) == names, mode
        assert set(full["probes_ms"]) == set(KINDS)
        times = shipped.times_ms(mode, full["pixels"], full["probes_ms"])
        assert times == pytest.approx(full["ms"])  # the machine that was measured, at the size that was
        twice = shipped.times_ms(mode, full["pixels"], {kind: 2 * ms for kind, ms in full["probes_ms"].items()})
        assert twice == pytest.approx({name: 2 * ms for name, ms in full["ms"].items()})
        middle = shipped.times_ms(mode, (full["pixels"] + half["pixels"]) // 2, full["probes_ms"])
        for name, ms in middle.items():  # what is brought to one size takes as long at both
            least, most = sorted((half["ms"][name], full["ms"][name]))
            assert least <= ms <= most, (mode, name)
        assert middle["stereo"] > half["ms"]["stereo"]
    assert set(shipped.errors()) == names


def test_more_disparities_take_classical_stereo_longer_and_nothing_else() -> None:
    for mode, (full, _) in shipped.table()["modes"].items():
        (near, far), probes = full["searched"], full["probes_ms"]
        times = [shipped.times_ms(mode, full["pixels"], probes, share) for share in (near, (near + far) / 2, far)]
        assert times[0] == pytest.approx(full["ms"])
        assert times[2] == pytest.approx(full["ms"] | full["ms_far"])
        for name in full["ms"]:
            less, middle, more = (found[name] for found in times)
            assert (less < middle < more) if name == "stereo" else less == middle == more


@pytest.mark.parametrize("side", ["left", "right"])
def test_what_is_searched_is_the_largest_disparity(side: Literal["left", "right"]) -> None:
    width, shift_px = 400, 24
    texture = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (96, width + shift_px)), (0, 0), 2)
    wide = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    left, right = wide[:, :width], wide[:, shift_px:]
    image, other = (left, right) if side == "left" else (right, left)
    camera = Camera(np.array([[300.0, 0, 200], [0, 300, 48], [0, 0, 1]]), (96, width))
    frame = Frame("0", camera, {"image": lambda: image, "other": lambda: other}, side=side)
    found = searched(frame)
    assert found is not None and shift_px <= found * width <= shift_px + 8
    assert searched(replace(frame, readers={"image": lambda: image})) is None


def test_a_frame_that_cannot_be_read_is_left_out_of_what_is_usual(own_street: Path) -> None:
    sound = usual(open_drive(own_street))
    image = open_drive(own_street)[0].files["image"]()
    assert sound is not None and image is not None
    image.write_bytes(b"no image")
    with pytest.raises(DataError):
        searched(open_drive(own_street)[0])
    assert usual(open_drive(own_street)) is not None


def test_a_mode_that_nobody_measured_takes_the_one_most_like_it() -> None:
    assert shipped.modes_like("amx")[0] == "avx512_bf16"


def test_calibration_takes_the_time_it_is_given() -> None:
    found = calibrate(0.05)
    assert set(found) == set(KINDS) and all(ms > 0 for ms in found.values())


def standing(name: str, method: Stereo | Lidar, seconds: float, abs_rel: float, density: float = 1.0) -> Standing:
    entrant = Entrant(name, method)
    metrics = {"abs_rel": abs_rel, "density": density, "density_image": density}
    made = Race._standing(None, entrant, _AnyFrame())  # type: ignore[arg-type]
    return replace(made, trials=[Trial("a", seconds, 0.0, seconds, metrics)])


class _AnyFrame:
    """A frame that has all."""

    missing: ClassVar[dict[str, str]] = {}

    def has(self, what: str) -> bool:
        return True


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Drive:
    """A pair's drive with a bench of its own in cache/."""
    monkeypatch.chdir(tmp_path)
    drive = open_drive(write_folder(tmp_path / "mine"))
    race = Race(judge(drive, range(len(drive)), 12, preset("paper"), None), [], Path("cache/mine/bench"))
    standings = (
        standing("stereo", Stereo(), 0.1, 0.03),
        standing("stereo cfnet-s bf16", Stereo("cfnet", runtime="bf16"), 0.3, 0.02),
        standing("lidar", Lidar(), 0.01, 0.001, 0.3),  # the drive has none: it cannot be chosen
    )
    Bench(race.asked, standings).save(race.folder)
    return drive


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str) -> tuple[int, str, str]:
        code = guarded(lambda: command.run(list(arguments)))
        done = capsys.readouterr()
        return code, done.out, done.err

    return call


def test_the_drive_s_own_bench_counts(drive: Drive) -> None:
    found = candidates(drive, drive[0], Path("cache"))
    assert [(each.name, each.source) for each in found] == [("stereo", OWN), ("stereo cfnet-s bf16", OWN)]
    assert found[1].changes == {"model": "cfnet", "runtime": "bf16"}
    assert most_accurate(found) == found[1]


def test_another_machine_s_bench_does_not_count(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expected, "calibrate", lambda: dict.fromkeys(KINDS, 10.0))
    bench = Bench.load(Path("cache/mine/bench"))
    other = {**bench.asked, "machine": {**bench.asked["machine"], "cpu": "of another kind"}}
    replace(bench, asked=other).save(Path("cache/mine/bench"))
    found = candidates(drive, drive[0], Path("cache"))
    assert {each.source for each in found} == {SHIPPED}
    assert {each.method.name for each in found} == {"stereo", "mono"}  # what a pair without a LiDAR allows


def test_build_takes_what_the_budget_allows(drive: Drive, run: Run) -> None:
    code, _, err = run("mine", "--budget", "150ms")
    assert (
        code == 0
        and "method: stereo: the best for 150 ms: 100 ms a frame, AbsRel 0.0300, measured on this drive" in err
    )
    code, out, err = run("mine", "--budget", "absrel=0.025", "--stereo.offset-px", "0", "--dry-run")
    assert code == 0 and "method: stereo cfnet-s bf16" in err and "3 to compute" in out
    (prior,) = find(Path("cache/mine"))
    assert prior.manifest["config"]["model"] == "classical"


def test_auto_takes_the_most_accurate_of_the_drive_s_bench(drive: Drive, run: Run) -> None:
    code, _, err = run("mine", "--method", "auto", "--dry-run")
    assert code == 0 and "method: stereo cfnet-s bf16: the most accurate of the drive's bench" in err


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("--budget", "1ms"), 1, r"nothing is as fast: the fastest is stereo, 100 ms a frame .*--method stereo"),
        (("--budget", "absrel=0.001"), 1, r"nothing is as right: the best is stereo cfnet-s bf16, AbsRel 0.0200"),
        (("--budget", "10"), 2, r"--budget 10: expected the time of a frame, as 100ms or 2s"),
        (("--budget", "1s", "--stereo.model", "cfnet"), 2, r"--stereo.model: --budget chooses it"),
        (("--budget", "1s", "--method", "lidar"), 2, r"what lidar takes here is not known"),
    ],
)
def test_what_cannot_be_is_a_line(drive: Drive, run: Run, arguments: tuple[str, ...], code: int, told: str) -> None:
    done = run("mine", *arguments)
    assert done[0] == code and re.search(told, done[2]) and done[2].count("error:") == 1
