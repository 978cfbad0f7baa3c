"""`priors list`: what a cache holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cli.arguments import by_drive, parse
from cli.console import DATA_ERROR, err, out
from priors import cache
from priors.cache import Prior
from priors.errors import DataError
from priors.naming import labels

EXAMPLES = """List what a cache holds: every prior, its frames, density and size; names frames that are half written.

examples:
  priors list
  priors list demo/cache
"""


@dataclass(frozen=True)
class ListArguments:
    """Arguments of `priors list`."""

    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE]")] = Path("cache")
    """The cache, or a folder in it."""


ARGUMENTS = {"priors list": ListArguments}


def run(arguments: list[str]) -> int:
    """List; returns the exit code: 1 where a frame is half written."""
    args = parse(ListArguments, "priors list", EXAMPLES, arguments)
    refused: list[DataError] = []
    priors = cache.find(args.path, refused.append)
    table = Table(box=SIMPLE_HEAD)
    for heading in ("drive", "prior", "folder"):
        table.add_column(heading, overflow="fold")
    for heading in ("frames", "density", "s/frame", "MiB"):
        table.add_column(heading, justify="right")
    for together in by_drive(priors):
        for prior, label in zip(together, labels(together), strict=True):
            table.add_row(str(prior.drive["name"]), label, prior.name, *_figures(prior))
    out.print(table)
    for error in refused:
        err.complain(error, "left out")
    broken = [(prior, why) for prior in priors for id_ in prior.ids() if (why := prior.why_not_done(id_))]
    for prior, why in broken:
        err.print(f"{prior.folder}: {why}: run the same `priors build` again")
    return DATA_ERROR if broken or refused else 0


def _figures(prior: Prior) -> list[str]:
    ids = prior.ids()
    densities, seconds = prior.figures("density", ids), prior.figures("seconds", ids)
    size = sum(path.stat().st_size for path in prior.folder.rglob("*.png"))
    density = f"{np.mean(densities):.1%}" if densities else "-"
    return [str(len(ids)), density, f"{np.median(seconds):.3f}" if seconds else "-", f"{size / 2**20:.1f}"]
