"""Build: what is computed, what is skipped and why, and that nothing done is lost."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from priors import build, selection
from priors.errors import DataError
from priors.filters import Filters
from priors.machine import threads
from priors.selection import Selection
from priors.types import Camera, Depth, Drive, Frame, Input, Method

SIZE = (8, 12)


class Line:
    """A drive along x, half a metre a frame, standing still in frames 3 to 5."""

    name = "line"

    def __init__(self, count: int = 10, unreadable: Sequence[int] = (), blind: Sequence[int] = ()) -> None:
        self.ids = [f"{number:06d}" for number in range(5, 5 + count)]
        self.unreadable, self.blind = unreadable, blind
        self.image_value = 7

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        if index in self.unreadable:
            raise DataError(f"oxts/{self.ids[index]}.txt: not a number")
        T_world_cam = np.eye(4)
        T_world_cam[0, 3] = 0.5 * (index if index < 3 else 3 if index < 6 else index - 2)
        image = np.full((*SIZE, 3), self.image_value, np.uint8)
        readers = {} if index in self.blind else {"image": lambda: image}
        missing = {"image": f"image/{self.ids[index]}.png is not there"}
        camera = Camera(np.diag([10.0, 10.0, 1.0]), SIZE)
        return Frame(self.ids[index], camera, readers, missing, T_world_cam)

    def describe(self) -> dict[str, Any]:
        return {"dataset": "line", "path": "/nowhere"}

    def fingerprint(self) -> str:
        return "f"


@dataclass(frozen=True)
class Plane(Method):
    """Depth is a constant; counts its calls."""

    depth_m: float = 5.0
    fails_on: str = ""
    interrupts_on: str = ""
    calls = []  # noqa: RUF012 - the test's own counter
    VERSION: ClassVar[int] = 1

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> "Plane":
        return self

    def __call__(self, frame: Frame) -> Depth:
        self.calls.append(frame.id)
        if frame.id == self.fails_on:
            raise DataError(f"frame {frame.id}: damaged image")
        if frame.id == self.interrupts_on:
            raise KeyboardInterrupt
        return Depth(np.full(SIZE, self.depth_m, np.float32))


@pytest.fixture(autouse=True)
def no_calls() -> None:
    Plane.calls.clear()


def run(
    drive: Drive,
    folder: Path,
    method: Plane | None = None,
    filters: Filters | None = None,
    selection: Selection | None = None,
    workers: int = 2,
) -> build.BuildReport:
    job = build.prepare(drive, method or Plane(), filters, folder)
    return job.run(job.plan(selection or Selection()), workers)


def test_a_second_build_computes_nothing(tmp_path: Path) -> None:
    drive = Line()
    first = run(drive, tmp_path)
    assert [line["id"] for line in first.built] == drive.ids
    Plane.calls.clear()
    second = run(drive, tmp_path)
    assert Plane.calls == []
    assert set(second.plan.skipped.values()) == {"cached"}
    np.testing.assert_array_equal(second.prior.read(drive.ids[0]).depth_m, np.full(SIZE, 5, np.float32))


@pytest.mark.parametrize(
    "change",
    [
        {"method": Plane(depth_m=6.0)},
        {"filters": Filters(clip=80)},
        {"filters": Filters(density=0.5, density_seed=1)},
    ],
)
def test_a_changed_flag_never_reuses_a_map(tmp_path: Path, change: dict[str, Any]) -> None:
    drive = Line()
    before = run(drive, tmp_path)
    Plane.calls.clear()
    after = run(drive, tmp_path, **change)
    assert after.prior.folder != before.prior.folder
    assert sorted(Plane.calls) == drive.ids


def test_a_filter_that_is_off_leaves_the_key_alone(tmp_path: Path) -> None:
    assert run(Line(), tmp_path).prior.folder == run(Line(), tmp_path, filters=Filters(density_seed=3)).prior.folder


def test_filters_are_applied(tmp_path: Path) -> None:
    report = run(Line(), tmp_path, filters=Filters(sky_rows=0.5))
    assert report.built[0]["density"] == 0.5


def test_a_frame_that_fails_is_reported_and_the_others_are_built(tmp_path: Path) -> None:
    drive = Line(unreadable=[2])
    report = run(drive, tmp_path, Plane(fails_on=drive.ids[7]))
    assert sorted(report.failed) == [drive.ids[2], drive.ids[7]]
    assert len(report.built) == 8
    Plane.calls.clear()
    again = run(Line(), tmp_path, Plane(fails_on=drive.ids[7]))
    assert sorted(Plane.calls) == [drive.ids[2], drive.ids[7]], "only what is missing is tried again"
    assert sorted(again.failed) == [drive.ids[7]]


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_an_interrupt_keeps_what_is_finished(tmp_path: Path, workers: int) -> None:
    drive = Line()
    interrupting = Plane(interrupts_on=drive.ids[4])
    with pytest.raises(KeyboardInterrupt):
        run(drive, tmp_path, interrupting, workers=workers)
    started = set(Plane.calls) - {drive.ids[4]}
    prior = build.prepare(drive, interrupting, folder=tmp_path).prior
    assert set(prior.ids()) == started, "every frame that was begun is there, whole"
    assert len(started) < len(drive), "the rest was not begun"


def test_frames_without_an_input_are_skipped_with_the_reason(tmp_path: Path) -> None:
    report = run(Line(blind=[1]), tmp_path)
    assert report.plan.skipped == {"000006": "image/000006.png is not there"}
    assert len(report.built) == 9


def test_still_frames_are_skipped_on_request(tmp_path: Path) -> None:
    report = run(Line(), tmp_path, selection=Selection(min_motion=0.3))
    assert sorted(report.plan.skipped) == ["000009", "000010"]
    assert all("stood still" in reason for reason in report.plan.skipped.values())


def test_slow_motion_adds_up(tmp_path: Path) -> None:
    report = run(Line(count=3), tmp_path, selection=Selection(min_motion=0.8))
    assert [line["id"] for line in report.built] == ["000005", "000007"]


def test_shards_part_the_drive(tmp_path: Path) -> None:
    drive = Line()
    built = [
        line["id"] for part in (1, 2, 3) for line in run(drive, tmp_path, selection=Selection(shard=f"{part}/3")).built
    ]
    assert sorted(built) == drive.ids
    assert len(run(drive, tmp_path).built) == 0


@pytest.mark.parametrize(
    ("frames", "ids"),
    [("5:7", ["000005", "000006"]), ("13:", ["000013", "000014"]), (":6", ["000005"]), ("9", ["000009"])],
)
def test_frames_are_numbers_of_the_file_names(frames: str, ids: list[str]) -> None:
    drive = Line()
    assert [drive.ids[index] for index in selection.select(drive.ids, frames)] == ids


def test_frames_are_positions_where_ids_are_timestamps() -> None:
    ids = ["315969904359876000", "315969904459876000", "315969904559876000"]
    assert selection.select(ids, "1:3") == [1, 2]


@pytest.mark.parametrize("frames", ["a:b", "100:200", "7:7", "--", "1:2:3"])
def test_bad_ranges_say_what_is_expected(frames: str) -> None:
    with pytest.raises(DataError, match="--frames"):
        selection.select(Line().ids, frames)


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/0", "-1/2"])
def test_bad_shards_say_what_is_expected(text: str) -> None:
    with pytest.raises(DataError, match="--shard"):
        selection.shard([1, 2, 3], text)


@pytest.mark.parametrize(
    ("count", "most", "picked"), [(10, 2, [2, 7]), (9, 4, [1, 3, 5, 7]), (3, 4, [0, 1, 2]), (0, 4, [])]
)
def test_middles_are_spread_evenly(count: int, most: int, picked: list[int]) -> None:
    assert selection.pick_middles(range(count), most) == picked


def test_a_dry_run_leaves_no_folder(tmp_path: Path) -> None:
    assert len(build.prepare(Line(), Plane(), folder=tmp_path / "cache").plan().todo) == 10
    assert not (tmp_path / "cache").exists()


def test_a_build_holds_the_threads_as_the_command_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Inside a build, OpenCV has as many threads as a command gives it; afterwards it has its own again."""
    used: list[int] = []
    plain = Plane.__call__

    def spy(method: Plane, frame: Frame) -> Depth:
        used.append(cv2.getNumThreads())
        return plain(method, frame)

    monkeypatch.setattr(Plane, "__call__", spy)
    before = cv2.getNumThreads()
    with threads.limited(3):
        run(Line(2), tmp_path / "limited")
    run(Line(2), tmp_path / "usual")
    assert used == [3, 3, threads.count(), threads.count()]
    assert cv2.getNumThreads() == before


def test_the_manifest_names_what_made_it(tmp_path: Path) -> None:
    manifest = run(Line(), tmp_path, Plane(depth_m=6.0), Filters(clip=80)).prior.manifest
    assert manifest["config"]["depth_m"] == 6.0
    assert manifest["filters"] == {"Clip": {"farthest_m": 80.0}}
    assert manifest["drive"]["name"] == "line"
    assert manifest["encoding"] == "kitti"


def test_a_moved_camera_has_another_key(tmp_path: Path) -> None:
    class Wider(Line):
        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            return replace(frame, camera=Camera(np.diag([11.0, 11.0, 1.0]), SIZE))

    keys = [build.prepare(drive, Plane(), folder=tmp_path).prior.name for drive in (Line(), Wider())]
    assert keys[0] != keys[1]
