"""`nerf eval`: score runs and put them into one table."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments, parse, pick_device
from cli.console import out, progress
from eval import lpips, typeset
from nerf import checkpoint
from nerf.page import runs_page
from nerf.pictures import compare, load_view
from nerf.report import Report, Truths, report
from nerf.run import Run, open_run
from nerf.scene import Scene
from nerf.study_table import COLUMNS
from nerf.view import renderer
from priors import codecs
from priors.errors import DataError, UsageError
from priors.report.page import SUFFIX, Picture
from priors.types import Drive, Image

EXAMPLES = """Score runs' held-out views and print one table; views that were rendered already are not rendered again.

examples:
  nerf eval runs/street-ngp-sparse
  nerf eval runs/a runs/b runs/c --save table.md table.tex
  nerf eval runs/a runs/b --save report.html        a page with the table, plots, pictures and settings
  nerf eval runs/a runs/b --pictures pictures       image, depth and error of each, a picture a held-out view
  nerf eval runs/a --lpips-weights squeezenet1_1_fp16.npz squeeze.pth
"""
WRITERS = {".md": typeset.markdown, ".tex": typeset.latex, ".txt": typeset.plain}
PICTURED = 4
"""Held-out views that are on a report page."""


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

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Runs' folders."""
    save: tuple[Path, ...] = ()
    """Also write the table: .md, .tex, .txt, or .html, a report page; as many as wanted."""
    pictures: Path | None = None
    """Also set the runs side by side: a picture of each held-out view in this folder."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ReportArguments, "nerf eval", EXAMPLES, arguments)
    bad = [path for path in args.save if path.suffix not in (*WRITERS, SUFFIX)]
    if bad:
        raise UsageError(f"--save {bad[0]}: expected a name that ends in {', '.join((*WRITERS, SUFFIX))}")
    with args.limited():
        return _score(args, shlex.join(["nerf", "eval", *arguments]))


def _score(args: ReportArguments, command: str) -> int:
    opened, reports = [], []
    for folder in args.runs:
        made = open_run(folder)
        drive = made.drive()
        scene = made.scene(drive, progress)
        opened.append((made, scene))
        reports.append(report_run(made, args.lpips, scene, drive, _told_by_study(folder), args.device))
    laid = print_table(reports)
    for path in args.save:
        if path.suffix == SUFFIX:
            views = _compared(opened, PICTURED) if _one_drive(opened) else ()  # the page says which drive a run has
            pictures = [Picture(f"frame {id_}", image) for id_, image in views]
            runs_page([made for made, _ in opened], reports, laid, pictures, command).write(path)
        else:
            codecs.write_bytes(path, WRITERS[path.suffix](laid).encode())
        out.print(f"wrote {path}")
    if args.pictures is not None:
        count = 0
        for id_, image in _compared(opened):
            codecs.write_image(args.pictures / f"{id_}.jpg", image, 90)
            count += 1
        out.print(f"wrote {count} pictures to {args.pictures}")
    return 0


def _told_by_study(folder: Path) -> dict[str, object] | None:
    """Return what a study wrote of a run, so that the study still finds it done; None where it was no study's."""
    path = folder / "metrics.json"
    info = Report.load(path).info if path.exists() else {}
    return info if "command" in info else None


def _compared(runs: Sequence[tuple[Run, Scene]], most: int | None = None) -> Iterator[tuple[str, Image]]:
    """Set the views side by side that all runs hold out, of one drive; at most `most`, spread evenly."""
    if not _one_drive(runs):
        raise DataError("--pictures: the runs are of several drives: name the runs of one")
    scene = runs[0][1]
    drive = runs[0][0].drive()
    ids = [[each.ids[position] for position in each.test] for _, each in runs]
    truths = Truths(drive, ids[0])
    common = [(id_, position) for id_, position in zip(ids[0], scene.test, strict=True) if all(id_ in i for i in ids)]
    step = 1 if most is None else max(1, len(common) // most)
    for id_, position in common[step // 2 :: step][:most]:
        views = [(made.name, *load_view(made.folder / "renders", id_)) for made, _ in runs]
        yield id_, compare(id_, scene.images[position], truths(id_), views)


def _one_drive(runs: Sequence[tuple[Run, Scene]]) -> bool:
    return len({made.drive().fingerprint() for made, _ in runs}) == 1


def report_run(
    made: Run,
    weights: LpipsArguments,
    scene: Scene,
    drive: Drive,
    info: dict[str, object] | None = None,
    device: Device = "auto",
) -> Report:
    """Score a run's held-out views."""
    render = renderer(checkpoint.open_model(made.folder, pick_device(device)))
    truths = Truths(drive, [scene.ids[position] for position in scene.test])
    told = info or {"name": made.name, "config": asdict(made.config)}
    key = checkpoint.digest(made.folder)
    with progress(f"views of {made.name}", len(scene.test)) as step:
        return report(scene, truths, render, made.folder, key, told, weights.open(), on_frame=step)


def print_table(reports: Sequence[Report]) -> typeset.Table:
    """Print a row a run."""
    rows = [((str(made.info["name"]),), made.metrics()) for made in reports]
    have = {key for _, figures in rows for key in figures}
    columns = {key: column for key, column in COLUMNS.items() if key in have}
    caption = f"{reports[0].protocol.describe()}; {len(reports[0].frames)} held-out views"
    remarks = list(dict.fromkeys(remark for made in reports for remark in made.remarks))
    laid = typeset.lay_out(("run",), columns, rows, caption, remarks)
    if out.is_terminal:
        out.print(typeset.render(laid, out.width))
    else:
        out.file.write(typeset.plain(laid))
    return laid
