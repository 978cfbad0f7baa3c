"""`nerf report`: one page with the table, pictures, plots and videos of runs, and of the priors that they lean on."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, out
from cli.nerf.eval import LpipsArguments, report_runs, scored_fields
from cli.priors import report as priors_report
from cli.priors.report import check_page
from cli.written import expect_file
from nerf.page import FieldScores
from nerf.run import find_all
from nerf.story import fitting, story_page
from priors.report.page import Page
from priors.report.sample import Sample
from priors.report.scores import DriveScores

EXAMPLES = """Write one page of runs: table, held-out views to compare by a slider, plots, videos, settings.
The file holds all that it shows: it opens from a disk, without a network.

examples:
  nerf report                                       all of runs/ -> report.html
  nerf report runs/a runs/b --cache cache/          the priors too: the whole story on one page
  nerf report runs/a --out a.html --most 20
"""


@dataclass(frozen=True)
class StoryArguments(ThreadArguments):
    """Arguments of `nerf report`."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (Path("runs"),)
    """Runs' folders, or folders that hold runs; default: all of runs/."""
    cache: tuple[Path, ...] = ()
    """Also show the priors of these caches, or drives' or priors' folders."""
    out: Path = Path("report.html")
    """The page."""
    data: Path | None = None
    """Where the drive is now, if it has moved."""
    device: Device = "auto"
    """Where to render what is not rendered yet; auto: a GPU where there is one."""
    sample: tyro.conf.OmitArgPrefixes[Sample] = field(default_factory=Sample)
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_page(self.out)


ARGUMENTS = {"nerf report": StoryArguments}


def run(arguments: list[str]) -> int:
    """Write the page; returns the exit code."""
    args = parse(StoryArguments, "nerf report", EXAMPLES, arguments)
    expect_file("--out", args.out)
    with args.limited():
        return _write(args, shlex.join(["nerf", "report", *arguments]))


def _write(args: StoryArguments, command: str) -> int:
    folders = find_all(args.runs)
    runs, reports = report_runs(folders, args.data, args.device, args.lpips.open())
    with busy("pictures for the page"):
        fields = scored_fields(runs, reports, args.sample)
    priors: list[DriveScores] = []
    whole = len(runs) == len(folders)
    if args.cache:
        asked = priors_report.ReportArguments(args.cache, args.out, data=args.data, sample=args.sample)
        priors, all_scored = priors_report.score_caches(asked)
        whole &= all_scored
    write_story(story_page(fields, priors, command, args.sample.room), args.out, (fields, priors), args.sample)
    return 0 if whole else DATA_ERROR


def write_story(page: Page, path: Path, shown: tuple[list[FieldScores], list[DriveScores]], sample: Sample) -> None:
    """Write a page, and say how large it is and what it had no room for."""
    with busy("page"):
        page.write(path)
    fields, priors = fitting(*shown, sample.room)
    wanted = [each.wipe for each in shown[1]] + [each.wipe for each in shown[0]]
    kept = [each.wipe for each in priors] + [each.wipe for each in fields]
    lacking = sum(len(one.views) - len(own.views) for one, own in zip(wanted, kept, strict=True) if one and own)
    if lacking:
        out.print(f"{lacking} pictured frames are left out: they do not fit into --megabytes {sample.megabytes:g}")
    if any(each.video_files and not each.videos for each in fields):
        err.print(f"videos are left out: they do not fit into --megabytes {sample.megabytes:g}")
    out.print(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB")
