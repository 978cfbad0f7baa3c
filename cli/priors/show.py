"""`priors show`: pictures of cached maps."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import built_frames, by_drive, drive_names, find_priors, parse, reopen_drive
from cli.console import DATA_ERROR, err, out, progress
from cli.written import expect_folder
from priors import codecs
from priors.cache import Prior
from priors.draw.comparison import compare
from priors.errors import DataError, expect_between
from priors.naming import labels
from priors.selection import LARGEST_FRAME_NUMBER, parse_range

EXAMPLES = """Write pictures: image and truth on top, then a row a prior - depth, error against the truth, confidence.

examples:
  priors show cache/ --frames 5:8
  priors show cache/DRIVE/stereo-KEY --out pictures --every 10
"""


@dataclass(frozen=True)
class ShowArguments:
    """Arguments of `priors show`."""

    caches: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE ...]")] = (Path("cache"),)
    """Caches, or drives' or priors' folders."""
    out: Path = Path("pictures")
    """Folder for the pictures: <out>/<drive>/<frame>.jpg."""
    frames: str | None = None
    """Only this range of frames, a:b."""
    every: int = 1
    """Only every n-th of them."""
    truth: Path | None = None
    """Folder with KITTI depth maps, where the build was not told."""
    data: Path | None = None
    """Where the drive is now, if it has moved since the build."""
    width: int = 620
    """Width of one tile, pixels."""

    def __post_init__(self) -> None:
        parse_range(self.frames)
        expect_between(1, self.every, LARGEST_FRAME_NUMBER, "--every")
        expect_between(16, self.width, 16384, "--width")


ARGUMENTS = {"priors show": ShowArguments}


def run(arguments: list[str]) -> int:
    """Write the pictures; returns the exit code."""
    args = parse(ShowArguments, "priors show", EXAMPLES, arguments)
    expect_folder("--out", args.out)
    priors = [prior for path in args.caches for prior in find_priors(path)]
    drives = by_drive(priors)
    whole = [_show_drive(together, name, args) for together, name in zip(drives, drive_names(drives), strict=True)]
    return 0 if all(whole) else DATA_ERROR


def _show_drive(priors: list[Prior], drive_name: str, args: ShowArguments) -> bool:
    """Write a drive's pictures; returns whether all maps could be read: those that cannot are named and left out."""
    drive = reopen_drive(priors, args.truth, args.data)
    indices = built_frames(priors, drive, args.frames)[:: args.every]
    names = labels(priors)
    folder, unread = args.out / drive_name, {}
    with progress("show", len(indices)) as step:
        for index in indices:
            frame, rows = drive[index], []
            for name, prior in zip(names, priors, strict=True):
                try:
                    if prior.depth_path(frame.id).exists():
                        rows.append((name, prior.read(frame.id)))
                except DataError as error:
                    unread[f"{name}, frame {frame.id}"] = error
            codecs.write_image(folder / f"{frame.id}.jpg", compare(frame, rows, args.width))
            step()
    out.print(f"wrote {len(indices)} pictures to {folder}")
    for what, why in unread.items():
        err.complain(why, f"left out: {what}")
    return not unread
