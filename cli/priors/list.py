"""`priors list`: what a cache holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cli.arguments import parse
from cli.console import DATA_ERROR, err, out
from priors import cache
from priors.cache import Prior
from priors.naming import labels

EXAMPLES = """List what a cache holds: every prior, its frames, density and size; names frames that are half written.

examples:
  priors list
  priors list demo/cache
"""


@dataclass(frozen=True)
class ListArguments:
    """Arguments of `priors list`."""

    path: Annotated[Path, tyro.conf.Positional] = Path("cache")
    """The cache, or a folder in it."""


ARGUMENTS = {"priors list": ListArguments}


def run(arguments: list[str]) -> int:
    """List; returns the exit code: 1 where a frame is half written."""
    args = parse(ListArguments, "priors list", EXAMPLES, arguments)
    priors = cache.find(args.path)
    table = Table(box=SIMPLE_HEAD)
    for heading in ("drive", "prior", "folder"):
        table.add_column(heading, overflow="fold")
    for heading in ("frames", "density", "s/frame", "MiB"):
        table.add_column(heading, justify="right")
    for prior, label in zip(priors, labels(priors), strict=True):
        table.add_row(str(prior.drive["name"]), label, prior.name, *_figures(prior))
    out.print(table)
    broken = [(prior, id_) for prior in priors for id_ in prior.ids() if not prior.has(id_)]
    for prior, id_ in broken:
        err.print(f"{prior.depth_path(id_)}: half written: run the same `priors build` again")
    return DATA_ERROR if broken else 0


def _figures(prior: Prior) -> list[str]:
    lines = [line for id_, line in prior.lines().items() if prior.depth_path(id_).exists()]
    density = f"{np.mean([line['density'] for line in lines]):.1%}" if lines else "-"
    seconds = f"{np.median([line['seconds'] for line in lines]):.3f}" if lines else "-"
    size = sum(path.stat().st_size for path in prior.folder.rglob("*.png"))
    return [str(len(prior.ids())), density, seconds, f"{size / 2**20:.1f}"]
