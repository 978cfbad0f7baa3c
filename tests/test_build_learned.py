"""What a method learns from the whole drive is part of what its maps are made of."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_build_anew import Files, built, job

from priors import cache
from priors.adapt.finetune import AdaptConfig
from priors.cache.audit import audit
from priors.cache.learned import FOLDER, WatchedDrive
from priors.cache.sources import Digests
from priors.methods import _mono_network as mono
from priors.methods._network import Network
from priors.nets import bts, weights
from priors.types import Depth, Drive, Frame, Input, Method


@dataclass(frozen=True)
class Learner(Method):
    """Depth is a constant that is learned from the first two frames."""

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> "Learner":
        return self

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        for index in (0, 1):
            drive[index].image()
        return self

    def __call__(self, frame: Frame) -> Depth:
        frame.image()
        return Depth(np.full(frame.camera.size, 5, np.float32))


@pytest.fixture
def drive(tmp_path: Path) -> Files:
    return Files(tmp_path / "images")


def lists(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"cache/*/*/{FOLDER}/*.json"))


def test_a_changed_file_that_was_learned_from_makes_all_maps_stale(drive: Files, tmp_path: Path) -> None:
    assert built(drive, tmp_path, Learner()) == drive.ids
    (path,) = lists(tmp_path)
    assert list(json.loads(path.read_text())) == drive.ids[:2]
    assert not built(drive, tmp_path, Learner())
    drive.path(drive.ids[3]).write_text("changed, and nobody learned from it")
    assert built(drive, tmp_path, Learner()) == [drive.ids[3]]
    drive.path(drive.ids[0]).write_text("changed")
    plan = job(drive, tmp_path, Learner()).plan()
    told = f"learned from the drive: frame {drive.ids[0]}: image: {drive.path(drive.ids[0]).name} has changed"
    assert plan.stale[drive.ids[2]] == told and len(plan.todo) == 4
    assert list(audit(job(drive, tmp_path, Learner()).prior, drive).stale) == drive.ids
    assert built(drive, tmp_path, Learner()) == drive.ids and not built(drive, tmp_path, Learner())


def test_a_build_that_was_stopped_goes_on_with_the_stale_ones(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path, Learner())
    drive.path(drive.ids[1]).write_text("changed")
    again = job(drive, tmp_path, Learner())
    plan = again.plan()
    again.run(replace(plan, todo=plan.todo[:3]))
    assert built(drive, tmp_path, Learner()) == [drive.ids[3]]


def test_files_of_equal_content_were_learned_from(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path, Learner())
    shutil.copytree(drive.folder, tmp_path / "copy", copy_function=shutil.copyfile)
    os.utime(drive.path(drive.ids[0]), (0, 0))
    assert not built(Files(tmp_path / "copy"), tmp_path, Learner()) and not built(drive, tmp_path, Learner())


@pytest.mark.parametrize("text", ["{", "[]", '{"000005": 3}', None])
def test_a_list_that_is_damaged_says_nothing(drive: Files, tmp_path: Path, text: str | None) -> None:
    built(drive, tmp_path, Learner())
    (path,) = lists(tmp_path)
    path.unlink()
    if text is not None:
        path.write_text(text)
    assert not built(drive, tmp_path, Learner())


def test_a_method_that_learns_nothing_has_no_list(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path)
    assert not lists(tmp_path)
    assert all("drive" not in line["made_of"] for line in job(drive, tmp_path).prior.lines().values())


def test_weights_that_were_adapted_to_other_files_are_adapted_again(
    drive: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    net, adapted = bts.Bts("s").eval(), []
    monkeypatch.setattr(mono, "_adapt", lambda planned, *rest: (planned.read(), adapted.append(1), net)[-1])
    weights.write(tmp_path / "start.safetensors", net, {"net": "bts", "size": "s"})

    def adapt() -> tuple[WatchedDrive, list[str]]:
        watched, notes = WatchedDrive(drive), []
        planned: Any = SimpleNamespace(frames=drive.ids[:1], decides={}, read=lambda: watched[0].image())
        network = Network("bts", "s", "fp32", tmp_path / "start.safetensors")
        mono.adapted_weights(watched, planned, network, AdaptConfig(), tmp_path / "weights", notes.append)
        return watched, notes

    first, _ = adapt()
    again, notes = adapt()
    assert len(adapted) == 1 and "before" in notes[0]
    assert list(again.sources(Digests())) == drive.ids[:1], "whoever uses them depends on what they learned from"
    assert again.sources(Digests()) == first.sources(Digests())
    drive.path(drive.ids[0]).write_text("changed")
    _, notes = adapt()
    assert len(adapted) == 2 and f"adapting again: frame {drive.ids[0]}: image:" in notes[0]
    adapt()
    assert len(adapted) == 2 and len(list((tmp_path / "weights").iterdir())) == 1


def test_a_prior_with_a_list_is_whole(drive: Files, tmp_path: Path) -> None:
    built(drive, tmp_path, Learner())
    found = audit(cache.load(lists(tmp_path)[0].parents[1]), drive)
    assert found.verified == drive.ids and not found.orphans and not found.stale
