"""Teaching: a network of the user's, from a file, over real pairs; by the command as a user runs it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from factories import write_odometry

from priors import codecs

PEER = """
import torch
from torch import nn

class Ramp(nn.Module):
    '''Says that the disparity is the column, times its only weight.'''
    def __init__(self):
        super().__init__()
        self.step = nn.Conv2d(1, 1, 1, bias=False)

    def forward(self, left, right):
        assert left.shape == right.shape and left.shape[1] == 3 and left.shape[2] % 32 == left.shape[3] % 32 == 0
        columns = torch.arange(left.shape[3], dtype=torch.float32).expand(1, 1, *left.shape[2:])
        return self.step(columns)[:, 0]
"""


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    write_odometry(tmp_path / "kitti_odometry", count=2, grey_only=True)
    (tmp_path / "ramp.py").write_text(PEER)
    torch.save({"state_dict": {"module.step.weight": torch.full((1, 1, 1, 1), 0.3)}}, tmp_path / "ramp.tar")
    places = [
        "--peer",
        tmp_path / "ramp.py",
        "--weights",
        tmp_path / "ramp.tar",
        "--data",
        tmp_path,
        "--out",
        tmp_path / "maps",
    ]
    return [
        sys.executable,
        "-m",
        "priors.learn.teacher_labels",
        *map(str, places),
        "--network",
        "Ramp",
        "--threads",
        "1",
    ]


def test_both_eyes_are_labelled_once(command: list[str], tmp_path: Path) -> None:
    subprocess.run(command, check=True, capture_output=True)
    maps = {path.stem: np.load(path) for path in (tmp_path / "maps").glob("*.npy")}
    assert sorted(maps) == ["06_000000", "06_000000_right", "06_000001", "06_000001_right"]
    height, width = codecs.read_image(tmp_path / "kitti_odometry/sequences/06/image_0/000000.png").shape[:2]
    left, right = maps["06_000001"], maps["06_000001_right"]
    np.testing.assert_allclose(left, np.tile(0.3 * np.arange(width), (height, 1)), rtol=1e-6)
    np.testing.assert_allclose(right, left[:, ::-1])  # made in the mirror, kept in the right eye's own pixels
    again = subprocess.run(command, check=True, capture_output=True, text=True)
    assert again.stdout == ""


def test_only_some_in_bfloat16(command: list[str], tmp_path: Path) -> None:
    subprocess.run([*command, "--sides", "left", "--every", "2", "--bf16"], check=True, capture_output=True)
    (path,) = (tmp_path / "maps").glob("*.npy")
    map_ = np.load(path)
    exact = 0.3 * np.arange(map_.shape[1])
    np.testing.assert_allclose(map_[0], exact, rtol=2**-7)
    assert np.abs(map_[0] - exact).max() > 0.01


def test_a_wrong_name_is_said_in_a_line(command: list[str]) -> None:
    done = subprocess.run([*command, "--network", "Ram"], capture_output=True, text=True)
    assert done.returncode != 0
    (line,) = done.stderr.strip().splitlines()
    assert "no class Ram" in line and line.endswith("--network")
