"""Which frames train: the study's split, shares and numbers of views, and sparse views at every rate."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_argoverse_tracking
from hypothesis import given, settings
from hypothesis import strategies as st
from test_nerf_scene import Corridor

from nerf import checkpoint
from nerf.config import FitConfig
from nerf.prepare import SceneConfig, open_scene
from nerf.rate import Rate
from nerf.run import begin, open_run
from nerf.split import HELD_OUT, in_name, split
from nerf.study import NONE, RunSpec
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.types import Frame


class Clocked(Corridor):
    """A corridor whose frames have times."""

    def __init__(self, times_s: list[float | None]) -> None:
        super().__init__(len(times_s))
        self.times_s = times_s

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        parts = {"T_world_cam": frame.T_world_cam, "time_s": self.times_s[index]}
        return Frame(frame.id, frame.camera, frame.readers, **parts)  # type: ignore[arg-type]


def at(hz: float, count: int = 40) -> Clocked:
    return Clocked([n / hz for n in range(count)])


def step_of(drive: Any) -> int:
    return Rate.of(drive, range(len(drive))).sparse_step


def test_the_study_s_split() -> None:
    train, held_out = split(40, "dense")
    assert held_out == [9, 19, 29, 39]
    assert len(train) == 36 and not set(train) & set(held_out)
    assert split(40, "sparse") == (train[::4], held_out)
    assert split(40, "sparse", 2) == (train[::2], held_out)
    assert split(40, "dense", 2) == (train, held_out) and split(40, HELD_OUT, 2) == (held_out, held_out)


@given(st.integers(1, 300), st.integers(1, 40))
def test_n_views_are_spread_evenly(count: int, wanted: int) -> None:
    rest = split(count, "dense")[0]
    if wanted > len(rest):
        with pytest.raises(DataError, match="--views"):
            split(count, str(wanted))
        return
    train, held_out = split(count, str(wanted))
    assert len(set(train)) == wanted and set(train) <= set(rest) and not set(train) & set(held_out)
    places = [rest.index(position) for position in train]
    assert max(np.diff(places), default=0) - min(np.diff(places), default=0) <= 1


@given(st.integers(1, 300), st.integers(1, 40), st.integers(1, 9))
def test_a_share_is_every_so_many_th_whatever_the_rate(count: int, n: int, step: int) -> None:
    rest, test = split(count, "dense")
    if n > len(rest):
        with pytest.raises(UsageError, match=rf"--views 1/{n}: expected dense, sparse or a share from 1/1 to 1/"):
            split(count, f"1/{n}")
        return
    assert split(count, f"1/{n}", step) == ([place for i, place in enumerate(rest) if i % n == 0], test)


REFUSED = [
    "",
    "all",
    "0",
    "-3",
    "1.5",
    "1/0",
    "2/8",
    "1/08",
    "1/-8",
    "1/",
    "/8",
    "1 / 8",
    "1/8/2",
    "\uff18",
    "9" * 5000,
]


@pytest.mark.parametrize("views", REFUSED)
def test_other_views_are_refused(views: str) -> None:
    for check in (lambda: split(20, views), lambda: SceneConfig(views)):
        with pytest.raises(UsageError, match=r"--views .{0,60}: expected dense, sparse, a share such as 1/8"):
            check()


@pytest.mark.parametrize(("hz", "step"), [(10, 4), (5, 2), (30, 12), (2.5, 1), (1, 1), (9.65, 4), (20, 8)])
def test_sparse_views_are_2_5_hz(hz: float, step: int) -> None:
    rate = Rate.of(at(hz), range(40))
    assert (rate.sparse_step, rate.is_told) == (step, True)
    assert str(rate) == f"{hz:.3g} Hz"


@settings(max_examples=30)
@given(st.lists(st.floats(-0.04, 0.04), min_size=20, max_size=40), st.sampled_from([5.0, 10.0]))
def test_a_clock_that_shakes_does_not_change_the_step(shakes: list[float], hz: float) -> None:
    assert step_of(Clocked([(n + shake) / hz for n, shake in enumerate(shakes)])) == hz / 2.5


def test_a_pause_or_frames_without_a_time_do_not_change_the_step() -> None:
    assert step_of(Clocked([0.1 * n + 60 * (n > 7) for n in range(20)])) == 4
    times: list[float | None] = [0.2 * n for n in range(20)]
    assert step_of(Clocked([*times[:9], None, float("nan"), *times[11:]])) == 2


@pytest.mark.parametrize("times", [[None] * 20, [float("nan")] * 20, [5.0] * 20, [0.0]])
def test_without_times_it_is_10_hz_and_said(times: list[float | None]) -> None:
    rate = Rate.of(Clocked(times), range(len(times)))
    assert (rate.sparse_step, rate.is_told, str(rate)) == (4, False, "10 Hz, for the drive has no times")


def test_argoverse_s_pair_has_5_hz(tmp_path: Path) -> None:
    assert step_of(open_drive(write_argoverse_tracking(tmp_path / "log-a", 3))) == 2


def test_a_range_has_its_own_rate() -> None:
    drive = Clocked([0.1 * n for n in range(10)] + [1 + 0.4 * n for n in range(10)])
    assert [Rate.of(drive, range(*ends)).sparse_step for ends in ((0, 10), (10, 20))] == [4, 1]


def test_a_scene_and_its_run_take_the_drive_s_rate(tmp_path: Path) -> None:
    train = split(40, "dense")[0]
    assert open_scene(at(5), None, SceneConfig("sparse"), tmp_path).train == train[::2]
    run = begin(at(5), None, SceneConfig("sparse"), FitConfig(steps=1), tmp_path / "runs" / "a")
    assert open_run(run.folder).config.parts(40)[0] == run.scene.train == train[::2]
    dense = begin(at(5), None, SceneConfig("dense"), FitConfig(steps=1), tmp_path / "runs" / "b")
    assert dense.config.sparse_step is None, "it has no part in other runs"


def test_a_run_of_an_earlier_version_keeps_its_views(tmp_path: Path) -> None:
    asked = at(5), None, SceneConfig("sparse"), FitConfig(steps=1), tmp_path / "run"
    path = begin(*asked).folder / "config.json"
    record = json.loads(path.read_text())
    assert record.pop("sparse_step") == 2
    path.write_text(json.dumps(record))
    assert open_run(path.parent).config.parts(40)[0] == split(40, "dense")[0][::4]
    (path.parent / checkpoint.NAME).touch()
    assert begin(*asked).config.parts(40)[0] == split(40, "dense")[0][::4], "it goes on with those"


def test_names_of_folders_have_no_slash(tmp_path: Path) -> None:
    assert in_name("1/8") == "1of8"
    assert RunSpec("ngp", "1/8", NONE).name == "ngp-1of8-none-seed0"
    run = begin(Corridor(), None, SceneConfig("1/8"), FitConfig(steps=1), tmp_path / "run")
    assert (run.config.title, run.config.views) == ("mip360-1of8", "1/8")
    assert open_run(run.folder).config.parts(20)[0] == run.scene.train == split(20, "dense")[0][::8]
