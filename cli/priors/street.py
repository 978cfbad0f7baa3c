"""`priors street`: write the embedded street."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import parse
from cli.console import out, progress
from priors.errors import DataError
from priors.street.write import write_street

EXAMPLES = """Write the embedded street as a KITTI raw drive: stereo pairs, LiDAR, poses, exact depth and sky.

examples:
  priors street street/
  priors street street/ --frames 40 --seed 7 --size 1242x375
  priors street small/ --frames 10 --size 320x96
"""


@dataclass(frozen=True)
class StreetArguments:
    """Arguments of `priors street`."""

    out: Annotated[Path, tyro.conf.Positional]
    """Folder to write into; frames that are there are kept."""
    frames: int = 40
    """How many frames, at 10 Hz."""
    seed: int = 7
    """Which street: the same seed gives the same bytes."""
    size: str = "1242x375"
    """Image size, width x height, pixels."""
    workers: int = os.cpu_count() or 1
    """Frames rendered at the same time."""


def run(arguments: list[str]) -> int:
    """Write the street; returns the exit code."""
    args = parse(StreetArguments, "priors street", EXAMPLES, arguments)
    with progress("street", args.frames) as step:
        drive = write_street(args.out, args.frames, args.seed, _size(args.size), step, args.workers)
    out.print(f"wrote {drive}")
    return 0


def _size(text: str) -> tuple[int, int]:
    """Turn WIDTHxHEIGHT into (height, width)."""
    try:
        width, height = (int(word) for word in text.lower().split("x"))
    except ValueError as error:
        raise DataError(f"--size {text}: expected WIDTHxHEIGHT, for example 1242x375") from error
    if width < 16 or height < 16:
        raise DataError(f"--size {text}: the smallest image is 16x16")
    return height, width
