"""Runs from Python: two lines do what `nerf fit` does, bit for bit, also on a drive that no command knows."""

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from nerf import checkpoint
from nerf.asked import CONFIG, RunConfig
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status
from nerf.prepare import SceneConfig
from nerf.run import OWNER, Run, begin, names_of, open_run
from nerf.viewpoints import read_poses
from priors.drives import open_drive
from priors.errors import DataError
from priors.filters import Filters
from priors.machine import threads
from priors.street.write import write_street
from priors.types import Camera, Drive, Frame

STEPS = 6


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home") / "street"
    write_street(folder, 10, 7, (32, 96))
    return folder


def config(**changes: Any) -> FitConfig:
    return FitConfig(ModelConfig(width=16), rays=256, steps=STEPS, **changes)


def test_two_lines_do_what_the_command_does(street: Path, tmp_path: Path) -> None:
    run = begin(open_drive(street), scene=SceneConfig(views="4"), fit=config(), folder=tmp_path / "python")
    run.fit()
    report = run.report()
    command = ["fit", street, "--views", 4, "--width", 16, "--rays", 256, "--steps", STEPS, "--run", tmp_path / "typed"]
    program = [sys.executable, "-c", "from cli.nerf import main; main()", *map(str, command)]
    subprocess.run(program, check=True, capture_output=True)
    ours, theirs = (load_file(tmp_path / name / checkpoint.NAME) for name in ("python", "typed"))
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(tensor, theirs[name]) for name, tensor in ours.items())
    typed = json.loads((tmp_path / "typed" / "metrics.json").read_text())["metrics"]
    for name, value in report.metrics().items():
        if typed[name] is not None and name != "render_s":
            assert value == pytest.approx(typed[name]), name


@dataclass(frozen=True)
class Mine:
    """A drive that is in memory alone: no reader could open it again."""

    source: Drive

    name = "mine"

    @property
    def ids(self) -> list[str]:
        return list(self.source.ids)

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, index: int) -> Frame:
        return self.source[index]

    def describe(self) -> dict[str, Any]:
        return {"dataset": "mine", "path": "memory"}

    def fingerprint(self) -> str:
        return "mine"


def test_a_drive_of_ones_own_is_fitted_and_scored(street: Path, tmp_path: Path) -> None:
    seen: list[Status] = []
    run = begin(Mine(open_drive(street)), fit=config(), folder=tmp_path / "run")
    run.fit("cpu", seen.append)
    assert [status.step for status in seen] == list(range(1, STEPS + 1))
    assert run.report("cpu").info["name"] == "run"
    with pytest.raises(DataError, match="memory: no such folder"):
        open_run(tmp_path / "run").report("cpu")


def test_a_run_is_named_after_what_it_is(street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    made = begin(open_drive(street), scene=SceneConfig(views="sparse"), fit=config())
    assert made.folder == Path("runs") / f"{open_drive(street).name}-mip360-sparse"
    with pytest.raises(DataError, match="expected dense, sparse, a share"):
        _ = begin(open_drive(street), scene=SceneConfig(views="x"), fit=config()).scene


def test_a_run_that_another_process_fits_is_refused(street: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = begin(open_drive(street), fit=config(), folder=folder)
    before = (folder / CONFIG).read_bytes()
    taker = f"from priors.owner.claim import take; from pathlib import Path; take(Path({str(folder / OWNER)!r}))"
    command = [sys.executable, "-c", f"{taker}; print(flush=True); input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout and other.stdout.readline()
        with pytest.raises(DataError, match=f"process {other.pid} on .*fits this run: wait for it, stop it, or"):
            begin(open_drive(street), fit=replace(config(), steps=9), folder=folder)
        with pytest.raises(DataError, match=f"process {other.pid} on .*has it in hand"):
            run.fit("cpu")
        other.kill()
    assert (folder / CONFIG).read_bytes() == before
    assert not (folder / checkpoint.NAME).exists()
    with run.held(), run.held():
        begin(open_drive(street), fit=config(), folder=folder)  # the owner itself is not refused
        run.fit("cpu")
    assert checkpoint.spent(folder).step == STEPS
    assert not (folder / OWNER).exists()


def test_a_table_s_names_are_as_short_as_they_can_be() -> None:
    def made(folder: str, prior: str | None) -> Run:
        return Run(Path(folder), RunConfig({}, prior, None, "sparse", Filters(), config()))

    alone, stereo = made("runs/street-mip360-sparse", None), "street-mip360-sparse-l1-stereo-"
    one = made(f"runs/{stereo}0123456789", "cache/street/stereo-0123456789")
    other = made(f"runs/{stereo}abcdef0123", "cache/street/stereo-abcdef0123")
    assert names_of([alone, one]) == ["mip360-sparse", "mip360-sparse-l1-stereo"]
    assert names_of([one, other]) == [f"{stereo}0123456789", f"{stereo}abcdef0123"]
    assert names_of([alone, made("runs/mine", None)]) == ["mip360-sparse", "mine"]
    assert names_of([alone, made("mip360-sparse", None)]) == ["street-mip360-sparse", "mip360-sparse"]


def test_views_are_rendered_where_they_are_asked_for(street: Path, tmp_path: Path) -> None:
    run = begin(open_drive(street), fit=config(), folder=tmp_path / "run")
    run.fit("cpu")
    views = run.viewpoints("2:4")
    assert views.ids == run.drive.ids[2:4]
    run.render(views, tmp_path / "views", "cpu")
    assert len(list((tmp_path / "views").rglob("*.png"))) == 6


def test_poses_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    camera = Camera(np.eye(3), (4, 4))
    for text, expected in (
        ("1 2 3", "found 3"),
        ("a b", "line 1: not 12 numbers"),
        ("# x\n", "found no line"),
        ("nan " * 12, "12 finite numbers"),
    ):
        (tmp_path / "poses.txt").write_text(text)
        with pytest.raises(DataError, match=expected):
            read_poses(tmp_path / "poses.txt", camera)


def test_poses_that_windows_wrote_are_read(tmp_path: Path) -> None:
    line = "1 0 0 4 0 1 0 5 0 0 1 6"
    (tmp_path / "poses.txt").write_bytes(f"\ufeff# route\r\n{line}\r\n{line} # end\r\n".encode("utf-16"))
    views = read_poses(tmp_path / "poses.txt", Camera(np.eye(3), (4, 4)))
    assert views.T_world_cam[:, :3, 3].tolist() == [[4, 5, 6]] * 2


def test_a_fit_holds_the_libraries_threads_as_the_command_does(street: Path, tmp_path: Path) -> None:
    """PyTorch's threads would spin between our kernels' calls, and keep the pool's from the cores."""
    counts = []
    with threads.limited(2):
        begin(open_drive(street), fit=config(), folder=tmp_path / "run").fit(
            "cpu", lambda status: counts.append((torch.get_num_threads(), threads.count()))
        )
        assert torch.get_num_threads() == 2
    assert set(counts) == {(1, 2)}
