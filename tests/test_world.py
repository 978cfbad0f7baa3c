"""Two processes that fit one field: the same field as one process with twice the rays, and the same bits each time."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from nerf_commands import SIZE, nerf
from safetensors.torch import load_file

from nerf.losses import trimmed
from nerf.roulette import chances, spin
from priors import build
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.street.write import write_street

pytestmark = pytest.mark.cluster
STEPS = 24


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, and its LiDAR prior in cache/."""
    folder = tmp_path_factory.mktemp("world")
    write_street(folder / "street", 10, 7, SIZE)
    build.prepare(open_drive(folder / "street"), Lidar(), folder=folder / "cache").run()
    return folder


def arguments(home: Path, run: str, rays: int, *more: object) -> list[str]:
    words = ["fit", home / "street", "--prior", home / "cache", "--steps", STEPS, "--rays", rays]
    return list(map(str, [*words, "--device", "cpu", "--threads", 1, "--run", home / "runs" / run, *more]))


def together(home: Path, run: str, rays: int, *more: object) -> subprocess.CompletedProcess[str]:
    """Fit with two processes."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    launch = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--master-port", str(port)]
    command = [*launch, "-m", "cli.nerf", "--", *arguments(home, run, rays, *more)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, env={**os.environ})


def weights(home: Path, run: str) -> dict[str, torch.Tensor]:
    return load_file(home / "runs" / run / "checkpoint.safetensors")


def journal(home: Path, run: str) -> list[dict[str, Any]]:
    lines = (home / "runs" / run / "metrics.jsonl").read_text("utf-8").splitlines()
    return [{name: value for name, value in json.loads(line).items() if name != "seconds"} for line in lines]


def test_two_processes_fit_what_one_does_with_twice_the_rays(home: Path) -> None:
    """Losses of each step agree to rounding; the journal is written once, and so is the report."""
    assert nerf(*arguments(home, "one", 256)) == 0
    done = together(home, "two", 128)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("wrote") == 1
    one, two = journal(home, "one"), journal(home, "two")
    assert [line["step"] for line in one] == [line["step"] for line in two]
    for mine, theirs in zip(one, two, strict=True):
        assert mine["samples"] == pytest.approx(theirs["samples"], rel=0.01)
        for name in ("loss", "rgb", "depth", "opacity", "distortion", "interlevel"):
            assert mine[name] == pytest.approx(theirs[name], rel=0.01), name
    own, other = weights(home, "one"), weights(home, "two")
    for name in ("model.sky.texels", "model.field.density0"):
        off = (own[name] - other[name]).abs().mean() / own[name].abs().mean()
        assert off < 0.02, (name, float(off))


def test_the_same_seed_gives_the_same_bits(home: Path) -> None:
    for run in ("first", "again"):
        done = together(home, run, 64)
        assert done.returncode == 0, done.stderr
    first, again = weights(home, "first"), weights(home, "again")
    assert all(torch.equal(first[name], again[name]) for name in first)


def test_what_one_process_only_can_fit_is_refused(home: Path) -> None:
    done = together(home, "splat", 64, "--field", "splat")
    assert done.returncode != 0 and "--field splat: expected one that several processes can fit together" in done.stderr


def test_draws_of_two_processes_are_those_of_one() -> None:
    random = np.random.Generator(np.random.Philox(key=[1, 2], counter=[0, 0, 0, 4]))
    whole = random.random(100, dtype=np.float32)
    assert np.array_equal(spin(torch.full((100,), 0.5), (1, 2), 4).numpy(), np.flatnonzero(whole < 0.5))
    assert torch.equal(chances(torch.ones(5), 0.1), torch.ones(5))
    assert torch.equal(trimmed(torch.ones(4), torch.tensor([1.0, 4.0, 2.0, 3.0]), 0.25), torch.tensor([1.0, 0, 1, 1]))
