"""`nerf eval`: score runs and put them into one table."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, out
from cli.nerf.arguments import open_moved
from cli.written import expect_file, expect_folder
from eval import lpips, typeset
from eval.files import write_bytes
from nerf.comparison import views_wipe
from nerf.page import FieldScores, lay_out
from nerf.pictures import compare, load_view
from nerf.report import Report
from nerf.run import Run, find_all, names_of
from nerf.story import story_page
from nerf.truths import Truths
from priors import codecs
from priors.errors import DataError, UsageError
from priors.report.page import SUFFIX
from priors.report.sample import Sample
from priors.types import Image

EXAMPLES = """Score runs' held-out views and print one table; views that were rendered already are not rendered again.

examples:
  nerf eval                                         all of runs/
  nerf eval runs/street-ngp-sparse
  nerf eval runs/a runs/b runs/c --save table.md table.tex
  nerf eval runs/a runs/b --save report.html        a page with the table, plots, pictures and settings
  nerf eval runs/a runs/b --pictures pictures       image, depth and error of each, a picture a held-out view
  nerf eval runs/a --lpips-weights squeezenet1_1_fp16.npz squeeze.pth
"""
WRITERS = {".md": typeset.markdown, ".tex": typeset.latex, ".txt": typeset.plain}


@dataclass(frozen=True)
class LpipsArguments:
    """LPIPS needs weights that the user brings."""

    lpips_weights: tuple[Path, ...] = ()
    """Backbone (torchvision's squeezenet1_1 or vgg16: .npz, .safetensors, .pth) and heads (squeeze.pth or vgg.pth)."""

    def open(self) -> lpips.Lpips | None:
        """Load the network, or return None where no weights are given."""
        return lpips.load(self.lpips_weights) if self.lpips_weights else None


@dataclass(frozen=True)
class ReportArguments(ThreadArguments):
    """Arguments of `nerf eval`."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (Path("runs"),)
    """Runs' folders, or folders that hold runs; default: all of runs/."""
    data: Path | None = None
    """Where the runs' drive is now, if it has moved."""
    save: tuple[Path, ...] = ()
    """Also write the table: .md, .tex, .txt, or .html, a report page; as many as wanted."""
    pictures: Path | None = None
    """Also set the runs side by side: a picture of each held-out view in this folder."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)


ARGUMENTS = {"nerf eval": ReportArguments}


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ReportArguments, "nerf eval", EXAMPLES, arguments)
    for path in args.save:
        expect_file("--save", path, (*WRITERS, SUFFIX))
    if args.pictures is not None:
        expect_folder("--pictures", args.pictures)
    with args.limited():
        return _score(args, shlex.join(["nerf", "eval", *arguments]))


def _score(args: ReportArguments, command: str) -> int:
    folders = find_all(args.runs)
    runs, reports = report_runs(folders, args.data, args.device, args.lpips.open())
    tables = print_tables(runs, reports)
    for path in args.save:
        if path.suffix == SUFFIX:
            with busy("page"):
                story_page(scored_fields(runs, reports, Sample()), [], command, Sample().room).write(path)
        else:
            write_bytes(path, "\n".join(map(WRITERS[path.suffix], tables)).encode())
        out.print(f"wrote {path}")
    if args.pictures is not None:
        count = 0
        with busy("pictures"):
            for id_, image in _compared(runs):
                codecs.write_image(args.pictures / f"{id_}.jpg", image, 90)
                count += 1
        out.print(f"wrote {count} pictures to {args.pictures}")
    return DATA_ERROR if len(runs) < len(folders) else 0


def report_runs(
    folders: Sequence[Path], data: Path | None, device: str, network: lpips.Lpips | None
) -> tuple[list[Run], list[Report]]:
    """Score the runs; those that cannot be scored are named and left out. DataError where none can."""
    runs, reports = [], []
    for folder in folders:
        try:
            run = open_moved(folder, data)
            reports.append(run.report(device, network))
            runs.append(run)
        except DataError as error:
            if len(folders) == 1:
                raise
            err.complain(error, f"left out: {folder}")
    if not runs:
        raise DataError(f"none of {len(folders)} runs can be scored: see above")
    return runs, reports


def scored_fields(runs: Sequence[Run], reports: Sequence[Report], sample: Sample) -> list[FieldScores]:
    """Put the runs of each drive together, with pictures of their held-out views."""
    scored = []
    for own, figures in _by_drive(runs, reports):
        of_drive = FieldScores(own, figures)
        scored.append(replace(of_drive, wipe=views_wipe(own, of_drive.figures, sample)))
    return scored


def _by_drive(runs: Sequence[Run], reports: Sequence[Report]) -> list[tuple[list[Run], list[Report]]]:
    """Sort runs and their reports by the drive."""
    drives: dict[str, tuple[list[Run], list[Report]]] = {}
    for run, report in zip(runs, reports, strict=True):
        own, figures = drives.setdefault(run.drive.fingerprint(), ([], []))
        own.append(run)
        figures.append(report)
    return list(drives.values())


def _compared(runs: Sequence[Run]) -> Iterator[tuple[str, Image]]:
    """Set the views side by side that all runs hold out, of one drive."""
    if not _one_drive(runs):
        raise UsageError("--pictures: the runs are of several drives: name the runs of one")
    drive, scene, names = runs[0].drive, runs[0].scene, names_of(runs)
    ids = [[each.scene.ids[position] for position in each.scene.test] for each in runs]
    truths = Truths(drive, ids[0])
    for id_, position in zip(ids[0], scene.test, strict=True):
        if all(id_ in own for own in ids):
            views = [(name, *load_view(each.folder / "renders", id_)) for name, each in zip(names, runs, strict=True)]
            yield id_, compare(id_, scene.images[position], truths(id_), views)


def _one_drive(runs: Sequence[Run]) -> bool:
    return len({each.drive.fingerprint() for each in runs}) == 1


def print_tables(runs: Sequence[Run], reports: Sequence[Report]) -> list[typeset.Table]:
    """Print a table a drive, in it a row a run."""
    drives = _by_drive(runs, reports)
    tables = []
    for own, figures in drives:
        laid = lay_out(names_of(own), figures)
        if len(drives) > 1:
            laid = replace(laid, caption=f"{own[0].drive.name}: {laid.caption}")
        if out.is_terminal:
            out.print(typeset.render(laid, out.width))
        else:
            out.write(typeset.plain(laid))
        tables.append(laid)
    return tables
