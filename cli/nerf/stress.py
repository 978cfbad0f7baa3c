"""`nerf stress`: the numerical routines of fields at the limits of their numbers, and fits with faulty inputs."""

import json
import shlex
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cli.arguments import parse
from cli.console import DATA_ERROR, err, out, progress
from cli.stress import StressArguments, stress
from priors.errors import UsageError, expect_between
from priors.stress.routine import Routine

if TYPE_CHECKING:
    from nerf.stress.fits import Row

EXAMPLES = """Run every numerical routine of fields (contraction, encoding, networks, compositing, losses, samples,
Adam) on extreme inputs, and compare values and gradients with float64. One line a routine; exits 1 where a cell fails.

examples:
  nerf stress
  nerf stress --only loss distortion
  nerf stress --json                                     every cell, and why some make no sense
  nerf stress --modes --markdown docs/numerics.md        in each CPU mode; the page's tables are made anew
  ROADPRIOR_CPU=plain nerf stress                        as on any CPU
  nerf stress --fits                                     whole fits: wrong priors, a black frame, ten times the rate
  nerf stress --fits --data street/ --prior cache/       on a drive of yours
"""
MOST_STEPS = 100_000


@dataclass(frozen=True)
class NerfStressArguments(StressArguments):
    """Arguments of `nerf stress`."""

    fits: bool = False
    """Make whole fits instead, with faulty inputs and settings, and compare them with what is stated of each."""
    field: Literal["mip360", "ngp", "nerfpp"] = "mip360"
    """With --fits: family of fields."""
    steps: int = 300
    """With --fits: steps of a fit."""
    data: Path | None = None
    """With --fits: a drive; default: a small street, written for it."""
    prior: Path | None = None
    """With --fits: a right prior of the drive; default: its own true depth."""

    def __post_init__(self) -> None:
        super().__post_init__()
        expect_between(1, self.steps, MOST_STEPS, "--steps")
        if self.fits and (self.modes or self.only):
            flag = "--modes" if self.modes else "--only"
            raise UsageError(f"{flag}: of the routines: leave out {flag} or --fits")
        usual = {"field": "mip360", "steps": 300, "data": None, "prior": None}
        idle = [name for name, value in usual.items() if getattr(self, name) != value]
        if idle and not self.fits:
            raise UsageError(f"--{idle[0]}: read with --fits: add it, or leave --{idle[0]} out")
        if self.prior is not None and self.data is None:
            raise UsageError(f"--prior {self.prior}: name its drive by --data")

    def routines(self) -> Sequence[Routine]:
        """Return the rows: contraction, encoding, networks, losses, ..."""
        from nerf.stress.routines import ROUTINES

        return ROUTINES


ARGUMENTS = {"nerf stress": NerfStressArguments}


def run(arguments: list[str]) -> int:
    """Make the table; returns the exit code."""
    args = parse(NerfStressArguments, "nerf stress", EXAMPLES, arguments)
    if args.fits:
        return _fits(args, shlex.join(["nerf", "stress", *arguments]))
    from nerf.stress.inputs import INPUTS

    return stress(args, "nerf", INPUTS, arguments)


def _fits(args: NerfStressArguments, command: str) -> int:
    """Make the fits, print and write their table; returns the exit code: 1 where one is not as stated."""
    from nerf.stress import fit_page, fit_scene, fits
    from priors.stress import page

    if args.markdown is not None:
        page.around(args.markdown, fit_page.NAME)  # before minutes of work
    with tempfile.TemporaryDirectory() as folder, args.limited():
        scene, truths = fit_scene.opened(args.data, args.prior, Path(folder))
        with progress("fits", len(fits.CASES)) as step:
            config = fits.config_of(args.field, args.steps)
            rows = fits.run(scene, truths, config, on_row=lambda row: step(row.case))
        name = scene.name
    _print(args, rows)
    if args.markdown is not None:
        page.put_into(args.markdown, fit_page.NAME, fit_page.markdown(rows, f"{command}\n\n{name}, {args.field}"))
        err.print(f"wrote {args.markdown}")
    return DATA_ERROR if any(row.fault for row in rows) else 0


def _print(args: NerfStressArguments, rows: "Sequence[Row]") -> None:
    from nerf.stress import fit_page

    if args.json:
        out.write(json.dumps([row.record() for row in rows], indent=1) + "\n")
        return
    out.write(fit_page.text(rows))
