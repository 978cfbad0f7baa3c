"""Builds on a cache that is there: stale and damaged maps are made anew and no others; two builds share the work."""

import json
import os
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_argoverse_tracking, write_folder, write_odometry, write_raw
from test_build import Line, Plane

from cli.arguments import by_drive, drive_names, folders_to_name, reopen_drive
from cli.priors import PROGRAM
from priors import build, cache, codecs
from priors.cache.audit import audit
from priors.cache.sources import Digests, watch, why_stale
from priors.drives import open_drive
from priors.errors import DataError
from priors.owner import claim
from priors.types import Camera, Depth, Drive, Frame, Input, Method


@dataclass(frozen=True)
class Reader(Method):
    """Depth is a constant; reads the image, and sweeps around the frame where there are any."""

    sweeps: int = 0

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> "Reader":
        return self

    def __call__(self, frame: Frame) -> Depth:
        frame.image()
        for offset in range(-self.sweeps, self.sweeps + 1):
            if frame.has("sweep"):
                frame.sweep(offset)
        return Depth(np.full(frame.camera.size, 5, np.float32))


class Files(Line):
    """The drive of test_build, its images in files that nobody decodes."""

    def __init__(self, folder: Path, count: int = 4) -> None:
        super().__init__(count)
        self.folder = folder
        folder.mkdir(exist_ok=True)
        for id_ in self.ids:
            if not self.path(id_).exists():
                self.path(id_).write_text(f"image {id_}")

    def path(self, id_: str) -> Path:
        return self.folder / f"{id_}.txt"

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        return replace(frame, files={"image": lambda: self.path(frame.id) if self.path(frame.id).exists() else None})


@pytest.fixture
def drive(tmp_path: Path) -> Files:
    return Files(tmp_path / "images")


def job(drive: Drive, folder: Path, method: Method | None = None) -> build.Job:
    return build.prepare(drive, method or Reader(), folder=folder / "cache")


def built(drive: Drive, folder: Path, method: Method | None = None) -> list[str]:
    return [line["id"] for line in job(drive, folder, method).run().built]


def test_only_frames_whose_files_have_changed_are_made_anew(drive: Files, tmp_path: Path) -> None:
    assert built(drive, tmp_path) == drive.ids
    drive.path(drive.ids[1]).write_text("image 000007")  # as large as before
    os.utime(drive.path(drive.ids[1]), (0, 0))
    drive.path(drive.ids[3]).write_text("longer than before")
    plan = job(drive, tmp_path).plan()
    assert plan.stale == {
        drive.ids[1]: "image: 000006.txt has changed",
        drive.ids[3]: "image: 000008.txt has changed",
    }
    assert built(drive, tmp_path) == [drive.ids[1], drive.ids[3]]
    assert not built(drive, tmp_path)


def test_copied_moved_and_touched_files_of_equal_content_are_not_stale(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    shutil.copytree(drive.folder, tmp_path / "copy", copy_function=shutil.copyfile)
    assert not job(Files(tmp_path / "copy"), tmp_path).plan().todo
    os.utime(drive.path(drive.ids[0]), (0, 0))
    plan = job(drive, tmp_path).plan()
    assert not plan.todo and list(plan.restamped) == [drive.ids[0]]
    assert not job(drive, tmp_path).run().built
    assert not job(drive, tmp_path).plan().restamped, "the new time is known: nothing is read again"


def test_a_map_whose_files_are_gone_is_kept_where_no_other_can_be_made(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    drive.path(drive.ids[0]).unlink()
    assert list(job(drive, tmp_path).plan().stale) == [drive.ids[0]], "the reader says that it can be read"
    drive.blind = [0]
    assert not job(drive, tmp_path).plan().todo


def test_a_drive_that_names_no_files_is_never_stale(tmp_path: Path) -> None:
    line = Line(3)
    assert built(line, tmp_path) == line.ids
    line.image_value = 9
    assert not built(line, tmp_path)


def test_maps_of_format_1_are_not_verified_and_not_stale(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    prior = job(drive, tmp_path).prior
    lines = [{k: v for k, v in line.items() if k not in ("maps", "made_of")} for line in prior.lines().values()]
    (prior.folder / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    path = prior.folder / "manifest.json"
    path.write_text(path.read_text().replace('"format": 2', '"format": 1'))
    drive.path(drive.ids[0]).write_text("changed")
    assert not built(drive, tmp_path)
    found = audit(cache.load(prior.folder), drive)
    assert found.unverified == drive.ids and not found.verified and not found.stale


LAYOUTS: dict[str, Callable[[Path], Path]] = {
    "kitti_raw": write_raw,
    "kitti_odometry": write_odometry,
    "argoverse1": write_argoverse_tracking,
}


@pytest.mark.parametrize("dataset", LAYOUTS)
def test_a_neighbours_sweep_that_comes_goes_or_changes_makes_a_map_stale(tmp_path: Path, dataset: str) -> None:
    folder = LAYOUTS[dataset](tmp_path / "data")

    def reason() -> str | None:
        return why_stale(sources, open_drive(folder)[1], Digests())

    watched = watch(open_drive(folder)[1])
    for offset in (0, -1, 1, 99):
        watched.frame.sweep(offset)
    sources = watched.sources(Digests())
    assert sources["sweep 99"] is None and len([call for call in sources if call.startswith("sweep ")]) == 4
    assert reason() is None
    name = dict(sources["sweep 1"] or {})["file"]
    (path,) = folder.rglob(name)
    whole = path.read_bytes()
    path.write_bytes(whole[:-16] + b"\0" * 16)
    assert reason() == f"sweep 1: {name} has changed"
    path.unlink()
    assert reason() == f"sweep 1: {name} is gone"
    sources = json.loads(json.dumps({**sources, "sweep 1": None}))
    assert reason() is None
    path.write_bytes(whole)
    assert reason() == f"sweep 1: {name} was not there"


def test_the_times_that_break_a_path_are_part_of_what_its_sweeps_make(tmp_path: Path) -> None:
    folder = write_odometry(tmp_path)
    times = folder / "sequences" / "06" / "times.txt"

    def reason() -> str | None:
        return why_stale(sources, open_drive(folder)[1], Digests())

    watched = watch(open_drive(folder)[1])
    watched.frame.image()
    assert "sweep.times" not in watched.calls, "no sweep was read"
    watched.frame.sweep(1)
    sources = watched.sources(Digests())
    assert reason() is None
    whole = times.read_text()
    times.write_text("".join(f"{30 * (n > 1) + 0.1 * n:.6e}\n" for n in range(5)))
    assert reason() == "sweep.times: times.txt has changed"
    times.unlink()
    assert reason() == "sweep.times: times.txt is gone"
    times.write_text(whole)
    assert reason() is None
    del sources["sweep.times"]  # as an earlier version recorded it
    times.unlink()
    assert reason() is None


def test_what_a_frame_has_not_got_is_part_of_what_a_map_was_made_of(tmp_path: Path) -> None:
    alone, pair = (write_folder(tmp_path / name, right=name == "pair") for name in ("alone", "pair"))
    watched = watch(open_drive(alone)[0])
    assert not watched.frame.has("other") and watched.frame.has("image")
    sources = watched.sources(Digests())
    assert sources == {"other": None}
    assert why_stale(sources, open_drive(alone)[0], Digests()) is None
    assert why_stale(sources, open_drive(pair)[0], Digests()) == "other: a.png was not there"


def test_a_file_that_changes_while_it_is_read_has_no_digest(tmp_path: Path) -> None:
    path = tmp_path / "0.txt"
    path.write_text("before")

    def read() -> str:
        path.write_text("afterwards")
        return path.read_text()

    frame = Frame("0", Camera(np.eye(3), (2, 2)), {"image": read}, files={"image": lambda: path})
    watched = watch(frame)
    watched.frame.read("image")
    sources = watched.sources(Digests())
    assert (sources["image"] or {})["sha256"] is None
    assert why_stale(sources, frame, Digests()) == "image: 0.txt has changed"


@pytest.mark.parametrize("sources", [None, [], "x", {"image": 3}, {"image": {"bytes": "x"}}, {"": None, "a b c": {}}])
def test_whatever_a_record_says_it_is_judged(drive: Files, sources: Any) -> None:
    assert why_stale(sources, drive[0], Digests()) in (
        None,
        "image: 000005.txt has changed",
        "image: 000005.txt was not there",
    )


def test_damaged_maps_are_made_anew_once_somebody_has_read_them(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    prior = job(drive, tmp_path).prior
    data = bytearray(prior.depth_path(drive.ids[2]).read_bytes())
    data[len(data) // 2] ^= 1
    prior.depth_path(drive.ids[2]).write_bytes(data)
    found = audit(prior, drive)
    assert list(found.damaged) == [drive.ids[2]] and len(found.verified) == 3
    plan = job(drive, tmp_path).plan()
    assert list(plan.damaged) == [drive.ids[2]] and not plan.stale
    assert built(drive, tmp_path) == [drive.ids[2]]
    assert not audit(job(drive, tmp_path).prior, drive).damaged


def test_a_damaged_manifest_is_written_again_and_whole_maps_are_kept(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    prior = job(drive, tmp_path).prior
    manifest = (prior.folder / "manifest.json").read_text()
    for text in ("{", None):
        (prior.folder / "manifest.json").unlink()
        if text is not None:
            (prior.folder / "manifest.json").write_text(text)
        data = bytearray(prior.depth_path(drive.ids[0]).read_bytes())
        data[len(data) // 2] ^= 1
        prior.depth_path(drive.ids[0]).write_bytes(data)
        assert built(drive, tmp_path) == [drive.ids[0]]
        assert (prior.folder / "manifest.json").read_text() == manifest
    (prior.folder / "manifest.json").write_text("{")
    assert not built(drive, tmp_path)
    assert (prior.folder / "manifest.json").read_text() == manifest


def test_the_priors_beside_one_follow_a_drive_that_has_moved(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "before" / "mine", right=False)
    priors = [job(open_drive(folder), tmp_path, Reader(sweeps)).run().prior for sweeps in (0, 1)]
    folder.parent.rename(tmp_path / "after")
    moved = open_drive(tmp_path / "after" / "mine")
    assert not job(moved, tmp_path, Reader(0)).run().built
    assert {cache.load(prior.folder).drive["path"] for prior in priors} == {str(tmp_path / "after" / "mine")}


def test_a_cache_is_checked_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_folder(tmp_path / "mine", right=False)
    prior = job(open_drive(folder), tmp_path).run().prior
    check = ["check", str(tmp_path / "cache")]
    assert PROGRAM.run(check) == 0
    assert "3 verified, 0 not verified, 0 stale, 0 damaged, 0 orphaned" in capsys.readouterr().out
    (prior.folder / "depth" / "notes.txt").write_text("x")
    shutil.copy(folder / "left" / "a.png", folder / "left" / "c.png")
    prior.depth_path("b").write_bytes(prior.depth_path("b").read_bytes()[:-1])
    assert PROGRAM.run(check) == 1
    told = capsys.readouterr().out
    assert "1 stale, 1 damaged, 1 orphaned" in told
    for line in ("stale .*c: image: c.png has changed", "damaged .*b: depth/b.png", "orphan .*depth/notes.txt"):
        assert re.search(line, told)
    assert built(open_drive(folder), tmp_path) == ["b", "c"]
    assert PROGRAM.run(check) == 0


def test_a_later_formats_prior_is_neither_read_nor_touched(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    prior = job(drive, tmp_path).prior
    later = json.dumps({**prior.manifest, "format": 3, "drive": "elsewhere"})
    (prior.folder / "manifest.json").write_text(later)
    with pytest.raises(DataError, match="cache format 3, this version reads up to 2: update"):
        job(drive, tmp_path)
    assert (prior.folder / "manifest.json").read_text() == later


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", ""])
def test_names_that_lead_out_of_the_cache_are_refused(tmp_path: Path, name: str) -> None:
    line = Line(2)
    line.ids[1] = name
    with pytest.raises(DataError, match=r"frame .* cannot be a file's name"):
        job(line, tmp_path)


def test_two_builds_share_the_frames_and_do_none_twice(tmp_path: Path) -> None:
    Plane.calls.clear()
    line, reports = Line(12), []
    jobs = [job(line, tmp_path, Slow()) for _ in range(2)]
    plans = [each.plan() for each in jobs]
    threads = [
        threading.Thread(target=lambda one=one, plan=plan: reports.append(one.run(plan)))
        for one, plan in zip(jobs, plans, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(Plane.calls) == line.ids, "each frame once"
    made = [{entry["id"] for entry in report.built} for report in reports]
    assert made[0] | made[1] == set(line.ids) and not made[0] & made[1] and made[0] and made[1]
    assert set(reports[0].left) == made[1] and set(reports[1].left) == made[0]
    assert not (jobs[0].prior.folder / "claims").exists()


@dataclass(frozen=True)
class Slow(Plane):
    """The plane, in time for another build."""

    def __call__(self, frame: Frame) -> Depth:
        threading.Event().wait(0.02)
        return super().__call__(frame)


def test_a_frame_that_another_build_does_not_finish_is_taken_over(tmp_path: Path) -> None:
    line, notes = Line(3), []
    one = job(line, tmp_path, Plane())
    held = claim.take(one.prior.folder / "claims" / line.ids[1])
    assert held is not None
    threading.Timer(0.4, held.release).start()
    report = one.run(on_note=notes.append)
    assert [entry["id"] for entry in report.built] == line.ids and not report.left
    assert len(notes) == 1 and "waiting for a frame that process" in notes[0]


def test_claims_of_killed_builds_are_cleared(tmp_path: Path) -> None:
    line = Line(3)
    one = job(line, tmp_path, Plane())
    dead = one.prior.folder / "claims" / line.ids[1]
    dead.parent.parent.mkdir(parents=True)
    for count in (3, 0):
        dead.parent.mkdir(exist_ok=True)
        dead.write_text("{")
        os.utime(dead, (0, 0))
        assert len(one.run().built) == count
        assert not dead.parent.exists()


def test_drives_of_one_name_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two drives in folders of one name: in one cache, and then one in the place of the other."""
    folders = [write_folder(tmp_path / name / "mine", right=False) for name in ("one", "two")]
    codecs.write_image(folders[1] / "left" / "a.png", np.zeros((96, 240), np.uint8))
    priors = [job(open_drive(folder), tmp_path).run().prior for folder in folders]
    groups = by_drive(cache.find(tmp_path / "cache"))
    assert sorted(str(group[0].folder) for group in groups) == sorted(str(prior.folder) for prior in priors)
    assert len(set(drive_names(groups))) == len(set(folders_to_name(groups))) == 2
    shutil.rmtree(folders[0])
    folders[1].rename(folders[0])
    with pytest.raises(
        DataError, match=r"is not the drive of .*: calibration, poses or first image differ: build again"
    ):
        reopen_drive([priors[0]])
    assert reopen_drive([priors[1]], data=folders[0]).name == "mine"
