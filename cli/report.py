"""`nerf eval`: score runs and put them into one table."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments, parse
from cli.console import out, progress
from eval import lpips, sheet
from nerf.pictures import compare, load_view
from nerf.report import Report
from nerf.run import Run, open_run
from nerf.study_table import COLUMNS
from nerf.truths import Truths
from priors import codecs
from priors.errors import DataError

EXAMPLES = """Score runs' held-out views and print one table; views that were rendered already are not rendered again.

examples:
  nerf eval runs/street-ngp-sparse
  nerf eval runs/a runs/b runs/c --save table.md table.tex
  nerf eval runs/a runs/b --pictures pictures       image, depth and error of each, a picture a held-out view
  nerf eval runs/a --lpips-weights squeezenet1_1_fp16.npz squeeze.pth
"""
WRITERS = {".md": sheet.markdown, ".tex": sheet.latex, ".txt": sheet.plain}


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
    """Also write the table: .md, .tex or .txt, as many as wanted."""
    pictures: Path | None = None
    """Also set the runs side by side: a picture of each held-out view in this folder."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ReportArguments, "nerf eval", EXAMPLES, arguments)
    bad = [path for path in args.save if path.suffix not in WRITERS]
    if bad:
        raise DataError(f"{bad[0]}: expected a table ending in {', '.join(WRITERS)}")
    with args.limited():
        return _score(args)


def _score(args: ReportArguments) -> int:
    lpips = args.lpips.open()
    runs = [replace(open_run(folder), progress=progress) for folder in args.runs]
    laid = print_table([each.report(args.device, lpips) for each in runs])
    for path in args.save:
        codecs.write_bytes(path, WRITERS[path.suffix](laid).encode())
        out.print(f"wrote {path}")
    if args.pictures is not None:
        _picture(runs, args.pictures)
    return 0


def _picture(runs: Sequence[Run], folder: Path) -> None:
    """Write a picture of each view that all runs hold out; they must be of one drive."""
    drive, scene = runs[0].drive, runs[0].scene
    if any(each.drive.fingerprint() != drive.fingerprint() for each in runs[1:]):
        raise DataError("--pictures: the runs are of several drives: name the runs of one")
    ids = [[each.scene.ids[position] for position in each.scene.test] for each in runs]
    truths = Truths(drive, ids[0])
    common = [(id_, position) for id_, position in zip(ids[0], scene.test, strict=True) if all(id_ in i for i in ids)]
    for id_, position in common:
        views = [(each.name, *load_view(each.folder / "renders", id_)) for each in runs]
        codecs.write_image(folder / f"{id_}.jpg", compare(id_, scene.images[position], truths(id_), views), 90)
    out.print(f"wrote {len(common)} pictures to {folder}")


def print_table(reports: Sequence[Report]) -> sheet.Sheet:
    """Print a row a run."""
    rows = [((str(each.info["name"]),), each.metrics()) for each in reports]
    have = {key for _, figures in rows for key in figures}
    columns = {key: column for key, column in COLUMNS.items() if key in have}
    caption = f"{reports[0].protocol.describe()}; {len(reports[0].frames)} held-out views"
    remarks = list(dict.fromkeys(remark for each in reports for remark in each.remarks))
    laid = sheet.lay(("run",), columns, rows, caption, remarks)
    if out.is_terminal:
        out.print(sheet.render(laid, out.width))
    else:
        out.file.write(sheet.plain(laid))
    return laid
