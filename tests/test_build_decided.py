"""What a build measured on the first frame is recalled by the next one, as long as it would be measured again so."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from factories import write_folder, write_raw

from priors import build, cache
from priors.build.decided import ENTRY
from priors.drives import open_drive
from priors.methods.stereo import Stereo
from priors.types import Depth, Drive, Frame, Input, Method


@dataclass(frozen=True)
class Measured(Method):
    """Depth is a constant: what is asked for, else the mean of the pair's images."""

    depth_m: float | None = None
    other: str = "x"

    measured: ClassVar[list[str]] = []

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    @property
    def measures(self) -> bool:
        return self.depth_m is None

    def resolve(self, frame: Frame) -> "Measured":
        if self.depth_m is not None:
            return self
        self.measured.append(frame.id)
        seen = [frame.image(), *([frame.other()] if frame.has("other") else [])]
        return replace(self, depth_m=round(float(np.mean(seen)), 3))

    def __call__(self, frame: Frame) -> Depth:
        return Depth(np.full(frame.camera.size, self.depth_m, np.float32))


@pytest.fixture(autouse=True)
def nothing_measured() -> None:
    Measured.measured.clear()


def built(drive: Drive, folder: Path, method: Method | None = None) -> build.Job:
    job = build.prepare(drive, method or Measured(), folder=folder / "cache")
    job.run()
    return job


def test_what_was_measured_is_recalled(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "mine")
    jobs = [built(open_drive(folder), tmp_path) for _ in range(3)]
    assert len(Measured.measured) == 1
    assert len({job.prior.name for job in jobs}) == 1 and jobs[0].method == jobs[2].method
    assert "decided" in json.loads((jobs[0].prior.folder / "manifest.json").read_text())


@pytest.mark.parametrize("side", ["left", "right"])
def test_another_content_of_a_file_that_was_read_is_measured_again(tmp_path: Path, side: str) -> None:
    folder = write_folder(tmp_path / "mine")
    before = built(open_drive(folder), tmp_path).method
    (folder / side / "a.png").write_bytes((folder / side / "b.png").read_bytes())
    after = built(open_drive(folder), tmp_path).method
    fresh = built(open_drive(folder), tmp_path / "fresh").method
    assert after == fresh != before


def test_a_file_that_has_come_is_measured_too(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "mine", right=False)
    built(open_drive(folder), tmp_path)
    write_folder(folder)
    built(open_drive(folder), tmp_path)
    assert len(Measured.measured) == 2


def test_other_wishes_are_measured_for_themselves(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "mine")
    built(open_drive(folder), tmp_path)
    other = built(open_drive(folder), tmp_path, Measured(other="y"))
    given = built(open_drive(folder), tmp_path, Measured(depth_m=7.0))
    assert len(Measured.measured) == 2
    assert vars(other.method)["other"] == "y" and vars(given.method)["depth_m"] == 7.0


def test_files_that_are_not_known_are_measured_each_time(tmp_path: Path) -> None:
    class Unknown:
        """A drive of another's, which does not name its files."""

        def __init__(self, drive: Drive) -> None:
            self.drive = drive

        def __getattr__(self, name: str) -> Any:
            return getattr(self.drive, name)

        def __len__(self) -> int:
            return len(self.drive)

        def __getitem__(self, index: int) -> Frame:
            return replace(self.drive[index], files={})

    drive: Any = Unknown(open_drive(write_folder(tmp_path / "mine")))
    for _ in range(2):
        built(drive, tmp_path)
    assert len(Measured.measured) == 2


def test_a_cache_of_an_earlier_version_is_told_once(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "mine")
    job = built(open_drive(folder), tmp_path)
    earlier = {name: value for name, value in job.prior.manifest.items() if name != ENTRY}
    cache.create(job.prior.folder, earlier)
    for _ in range(3):
        assert not built(open_drive(folder), tmp_path).plan().todo
    assert len(Measured.measured) == 2


@pytest.mark.parametrize(
    "spoil",
    [
        lambda m: m | {"decided": 3},
        lambda m: m | {"decided": m["decided"] | {"made_of": []}},
        lambda m: m | {"decided": m["decided"] | {"rig": "another"}},
        lambda m: m | {"config": {"unheard": 1}},
        lambda m: m | {"config": None},
        lambda m: m | {"fingerprint": "another"},
        lambda m: m | {"version": 7},
    ],
)
def test_what_does_not_fit_is_measured_again(tmp_path: Path, spoil: Callable[[Any], Any]) -> None:
    folder = write_folder(tmp_path / "mine")
    path = built(open_drive(folder), tmp_path).prior.folder / "manifest.json"
    path.write_text(json.dumps(spoil(json.loads(path.read_text()))))
    built(open_drive(folder), tmp_path)
    assert len(Measured.measured) == 2


def test_stereo_recalls_its_rectification(tmp_path: Path) -> None:
    folder = write_raw(tmp_path / "data", ids=range(2))
    first = built(open_drive(folder), tmp_path, Stereo())
    again = build.prepare(open_drive(folder), Stereo(), folder=tmp_path / "cache")
    fresh = build.prepare(open_drive(folder), Stereo(), folder=tmp_path / "other")
    assert again.method == fresh.method == first.method
    assert again.prior.name == fresh.prior.name
    assert again.prior.manifest[ENTRY] == first.prior.manifest[ENTRY]
