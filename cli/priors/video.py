"""`priors video`: the depth of one or several priors over a drive, side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import built_frames, by_drive, find_priors, parse, reopen_drive
from cli.console import DATA_ERROR, busy, err, out, progress
from cli.written import expect_file
from priors import cache
from priors.cache import Prior
from priors.codecs import as_rgb
from priors.draw import panel
from priors.draw.mp4 import write_mp4
from priors.draw.panel import Tile
from priors.errors import DataError, UsageError, expect, expect_between
from priors.flicker import flicker_of
from priors.naming import labels
from priors.selection import parse_range
from priors.types import Depth, Drive, Frame, Image

EXAMPLES = """Write a video of the images and of priors' depth, all in one scale of colours.

examples:
  priors video cache/
  priors video cache/DRIVE/stereo-A cache/DRIVE/stereo-B --frames 26:51 --out steady.mp4
  priors video cache/ --flicker                            how steady each is stands above it; needs poses and truth
  priors video cache/ --against cache/DRIVE/lidar-KEY      the same, with another prior as truth
"""


@dataclass(frozen=True)
class VideoArguments:
    """Arguments of `priors video`."""

    caches: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE ...]")] = (Path("cache"),)
    """Priors' folders, or caches: of one drive."""
    out: Path = Path("depth.mp4")
    """The file."""
    frames: str | None = None
    """Only this range of frames, a:b."""
    fps: float = 10.0
    """Frames a second; KITTI's are recorded at 10."""
    columns: int = 1
    """Pictures side by side; the image is the first."""
    width: int = 828
    """Width of each picture, pixels."""
    flicker: bool = False
    """Say above each prior how much its depth of a still point differs from frame to frame."""
    against: Path | None = None
    """The same, with this prior in place of the drive's truth."""
    truth: Path | None = None
    """Folder with KITTI depth maps, where the build was not told."""
    data: Path | None = None
    """Where the drive is now, if it has moved since the build."""

    def __post_init__(self) -> None:
        parse_range(self.frames)
        expect(0 < self.fps <= 240, "--fps", self.fps, "more than 0, 240 at most")
        expect_between(1, self.columns, 16, "--columns")
        expect_between(64, self.width, 4096, "--width")
        expect(self.out.suffix.lower() == ".mp4", "--out", self.out, "a name that ends in .mp4")


ARGUMENTS = {"priors video": VideoArguments}


def run(arguments: list[str]) -> int:
    """Write the video; returns the exit code."""
    args = parse(VideoArguments, "priors video", EXAMPLES, arguments)
    expect_file("--out", args.out)
    priors = [prior for path in args.caches for prior in find_priors(path)]
    drives = by_drive(priors)
    if len(drives) > 1:
        names = ", ".join(together[0].drive["name"] for together in drives)
        raise UsageError(f"priors video: the priors are of {len(drives)} drives, {names}: name those of one")
    return _write(priors, args)


def _write(priors: Sequence[Prior], args: VideoArguments) -> int:
    """Write the video of one drive's priors; maps that cannot be read are named, and their places stay dark."""
    with busy("opening the drive"):
        drive = reopen_drive(priors, args.truth, args.data)
    indices = built_frames(priors, drive, args.frames)
    titles = _titles(priors, drive, [drive.ids[index] for index in indices], args)
    unread: dict[str, DataError] = {}

    def pictures() -> Iterator[Image]:
        for index in indices:
            maps = [_read(prior, drive.ids[index], unread) for prior in priors]
            yield picture(drive[index], list(zip(titles, maps, strict=True)), args.columns, args.width)
            step()

    with progress("video", len(indices)) as step:
        count = write_mp4(args.out, pictures(), args.fps)
    out.print(f"wrote {args.out}: {count} frames")
    for what, why in unread.items():
        err.complain(why, f"left out: {what}")
    return DATA_ERROR if unread else 0


def _titles(priors: Sequence[Prior], drive: Drive, ids: Sequence[str], args: VideoArguments) -> list[str]:
    """Name each prior, with its flicker where that is asked for."""
    names = labels(priors)
    if not args.flicker and args.against is None:
        return names
    against = None if args.against is None else cache.only(args.against)
    titles = []
    for name, prior in zip(names, priors, strict=True):
        with busy(f"flicker of {name}"):
            known = [id_ for id_ in ids if prior.has(id_) and _has_truth(drive, id_, against)]
            titles.append(f"{name}, flicker {100 * flicker_of(prior, drive, known, against):.2f} %")
        out.print(titles[-1])
    return titles


def _has_truth(drive: Drive, frame_id: str, against: Prior | None) -> bool:
    return drive[drive.ids.index(frame_id)].has("truth") if against is None else against.has(frame_id)


def _read(prior: Prior, frame_id: str, unread: dict[str, DataError]) -> Depth | None:
    """Return a map; None where there is none, and where it cannot be read, which is noted."""
    try:
        return prior.read(frame_id) if prior.depth_path(frame_id).exists() else None
    except DataError as error:
        unread[f"{prior.name}, frame {frame_id}"] = error
        return None


def picture(frame: Frame, rows: Sequence[tuple[str, Depth | None]], columns: int, width: int) -> Image:
    """Lay out a frame of the video: the image, then each prior's depth in the same colours; dark where it has none."""
    image = as_rgb(frame.image())
    tiles = [Tile(image, f"frame {frame.id}")]
    tiles += [Tile(image * 0, name) if depth is None else panel.depth_tile(depth, name) for name, depth in rows]
    return panel.panel(tiles, columns, width)
