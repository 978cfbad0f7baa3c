"""`priors report`: one page with the tables, pictures and plots of cached maps."""

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cli.arguments import by_drive, drive_names, parse, reopen_drive
from cli.console import DATA_ERROR, busy, err, out
from cli.priors.eval import ScoreArguments, score_prior, with_maps
from cli.written import expect_file
from eval.protocol import PRESETS
from priors.bench.results import of_drive
from priors.bench.table import chapter
from priors.cache import Prior
from priors.errors import DataError, UsageError
from priors.naming import labels
from priors.report.frames import frames_wipe
from priors.report.page import SUFFIX, Chapter, Page
from priors.report.sample import Sample
from priors.report.scores import DriveScores, scores_page, within
from priors.selection import select

EXAMPLES = """Write one page of cached maps: tables, pictures to compare by a slider, errors by distance and confidence.
The file holds all that it shows: it opens from a disk, without a network.

examples:
  priors report                                     all of cache/ -> report.html
  priors report cache/ --out page.html --most 20
  priors report cache/DRIVE/stereo-KEY cache/DRIVE/lidar-KEY --frames 5:17
"""


@dataclass(frozen=True)
class ReportArguments:
    """Arguments of `priors report`."""

    caches: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE ...]")] = (Path("cache"),)
    """Caches, or drives' or priors' folders."""
    out: Path = Path("report.html")
    """The page."""
    protocol: Literal[*PRESETS] = "paper"  # type: ignore[valid-type]
    """Which pixels count and how; docs/metrics.md has the definitions."""
    frames: str | None = None
    """Score and picture only this range of frames, a:b."""
    truth: Path | None = None
    """Folder with KITTI depth maps, where the build was not told."""
    data: Path | None = None
    """Where the drive is now, if it has moved since the build."""
    sample: tyro.conf.OmitArgPrefixes[Sample] = field(default_factory=Sample)

    def __post_init__(self) -> None:
        check_page(self.out)
        self.scoring  # noqa: B018  its own checks

    @property
    def scoring(self) -> ScoreArguments:
        """Return how `priors eval` is asked for the same."""
        return ScoreArguments(self.caches, self.protocol, frames=self.frames, save=(self.out,))


ARGUMENTS = {"priors report": ReportArguments}


def run(arguments: list[str]) -> int:
    """Write the page; returns the exit code."""
    args = parse(ReportArguments, "priors report", EXAMPLES, arguments)
    expect_file("--out", args.out)
    scored, whole = score_caches(args)
    page = scores_page(scored, None, shlex.join(["priors", "report", *arguments]), args.sample.room)
    page = replace(page, chapters=[*page.chapters, *_benches(scored)])
    write_page(page, args.out, scored, args.sample)
    return 0 if whole else DATA_ERROR


def score_caches(args: ReportArguments) -> tuple[list[DriveScores], bool]:
    """Score and picture the priors of each drive; returns them, and whether they are all.

    What cannot be read is named and left out. A drive without a truth has pictures alone: that is whole.
    """
    refused: list[DataError] = []
    priors = [prior for path in args.caches for prior in with_maps(path, refused)]
    for error in refused:
        err.complain(error, "left out")
    drives = by_drive(list({prior.folder.resolve(): prior for prior in priors}.values()))
    if not drives:
        raise DataError(f"{args.caches[0]}: no maps yet: build them first (`priors build`)")
    scored = []
    for together, name in zip(drives, drive_names(drives), strict=True):
        try:
            scored.append(_score_drive(together, name, args))
        except DataError as error:
            if len(drives) == 1:
                raise
            err.complain(error, f"left out: {together[0].folder.parent}")
    if not scored:
        raise DataError(f"none of {len(drives)} drives can be opened: see above")
    lost = bool(refused) or len(scored) < len(drives) or any(each.left_out for each in scored if each.results)
    return scored, not lost


def _benches(scored: list[DriveScores]) -> list[Chapter]:
    """Lay out what `priors bench` has measured of these drives."""
    firsts = [next(iter(each.priors.values())) for each in scored if each.priors]
    found = [of_drive(prior.folder.parent, str(prior.manifest.get("fingerprint"))) for prior in firsts]
    return [chapter(bench) for bench in found if bench is not None]


def _score_drive(priors: list[Prior], drive_name: str, args: ReportArguments) -> DriveScores:
    """Score and picture the priors of one drive; those that cannot be scored are pictured all the same."""
    drive = reopen_drive(priors, args.truth, args.data)
    select(drive.ids, args.frames)  # frames that no prior can have are told once
    scored = DriveScores([], priors=dict(zip(labels(priors), priors, strict=True)), name=drive_name)
    for name in scored.priors:
        try:
            score_prior(scored, name, drive, args.scoring)
        except DataError as error:
            scored.left_out[name] = str(error)
            err.complain(error, f"not scored: {name}")
    for what, why in scored.left_out.items():
        if what not in scored.priors:
            err.complain(why, f"left out: {what}")
    with busy("pictures for the page"):
        wipe = frames_wipe(drive, scored.priors, scored.results, args.sample, args.frames)
    return replace(scored, wipe=wipe)


def check_page(path: Path) -> None:
    """Refuse a page's name before any work."""
    if path.suffix != SUFFIX:
        raise UsageError(f"--out {path}: expected a name that ends in {SUFFIX}")


def write_page(page: Page, path: Path, scored: list[DriveScores], sample: Sample) -> None:
    """Write a page, and say how large it is and which frames it had no room for."""
    with busy("page"):
        page.write(path)
    wanted = max((len(each.wipe.views) for each in scored if each.wipe), default=0)
    shown = max((len(each.wipe.views) for each in within(scored, sample.room) if each.wipe), default=0)
    if shown < wanted:
        out.print(
            f"{shown} of {wanted} frames are pictured: the others do not fit into --megabytes {sample.megabytes:g}"
        )
    out.print(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB")
