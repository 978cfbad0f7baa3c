"""`priors street`: write the embedded street."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import parse
from cli.console import out, progress
from priors.errors import LARGEST_SEED, UsageError, expect, expect_between
from priors.machine.threads import MOST_THREADS
from priors.street.write import Asked, Corner, write_drive

EXAMPLES = """Write the embedded street as a KITTI raw drive: stereo pairs, LiDAR, poses, exact depth and sky.

examples:
  priors street street/
  priors street street/ --frames 40 --seed 7 --size 1242x375
  priors street small/ --frames 10 --size 320x96
  priors street corner/ --corner left                     a drive that turns by 90 degrees
"""
LARGEST_SIDE_PX = 16384


@dataclass(frozen=True)
class StreetArguments:
    """Arguments of `priors street`."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder to write into; frames that are there are kept."""
    frames: int = 40
    """How many frames, at 10 Hz."""
    seed: int = 7
    """Which street: the same seed gives the same bytes."""
    size: str = "1242x375"
    """Image size, width x height, pixels."""
    corner: Corner = "none"
    """Where the street turns by 90 degrees; 40 frames drive around it."""
    workers: int = os.cpu_count() or 1
    """Frames rendered at the same time."""

    def __post_init__(self) -> None:
        expect_between(1, self.frames, 100_000, "--frames")
        expect_between(0, self.seed, LARGEST_SEED, "--seed")
        expect_between(1, self.workers, MOST_THREADS, "--workers")
        _size(self.size)


ARGUMENTS = {"priors street": StreetArguments}


def run(arguments: list[str]) -> int:
    """Write the street; returns the exit code."""
    args = parse(StreetArguments, "priors street", EXAMPLES, arguments)
    with progress("street", args.frames) as step:
        asked = Asked(args.frames, args.seed, _size(args.size), args.corner)
        drive = write_drive(args.out, asked, step, args.workers)
    out.print(f"wrote {drive}")
    return 0


def _size(text: str) -> tuple[int, int]:
    """Turn WIDTHxHEIGHT into (height, width)."""
    try:
        width, height = (int(word) for word in text.lower().split("x"))
    except ValueError as error:
        raise UsageError(f"--size {text or repr(text)}: expected WIDTHxHEIGHT, for example 1242x375") from error
    fits = 16 <= width <= LARGEST_SIDE_PX and 16 <= height <= LARGEST_SIDE_PX
    expect(fits, "--size", text, f"sides from 16 to {LARGEST_SIDE_PX} pixels")
    return height, width
