"""`nerf`'s commands, run in this process, and what of a tiny street's fit several files of tests look at."""

from pathlib import Path

import pytest

from cli.nerf import PROGRAM

SIZE = (32, 96)
HELD_OUT = "0000000009"
ALL = ("--opacity", 0.0, "--agreement", 1e9, "--farthest-m", 1e9)
"""Of a field that has learned for three steps, every pixel is a point of a cloud."""


def nerf(*arguments: object) -> int:
    return PROGRAM.run([str(argument) for argument in arguments])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run what must fail; returns its one line."""
    capsys.readouterr()
    assert nerf(*arguments) in (1, 2)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    return lines[0]


def prior_of(home: Path) -> Path:
    return next((home / "cache").glob("*/lidar-*"))
