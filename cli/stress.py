"""What `priors stress` and `nerf stress` share: arguments, and what is done with the table."""

import json
import shlex
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cli.arguments import ThreadArguments
from cli.console import DATA_ERROR, err, out, progress
from cli.written import expect_file
from priors.errors import UsageError
from priors.stress import modes, page
from priors.stress.inputs import Input
from priors.stress.routine import Routine, named
from priors.stress.table import Table
from priors.stress.table import run as make


@dataclass(frozen=True)
class StressArguments(ThreadArguments, ABC):
    """Arguments of both."""

    only: tuple[str, ...] = ()
    """Test only the routines that have one of these words in their name."""
    json: bool = False
    """Print every cell as JSON instead of the table."""
    modes: bool = False
    """Make the table in each CPU mode that this machine has."""
    markdown: Path | None = None
    """Write the tables into this page too, between its marks."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.only:
            self.chosen()
        if self.markdown is not None:
            expect_file("--markdown", self.markdown, (".md",))
        if self.json and self.modes:
            raise UsageError("--json --modes: choose one of them; or run ROADPRIOR_CPU=MODE ... --json for each mode")

    @abstractmethod
    def routines(self) -> Sequence[Routine]:
        """Return all rows of this program's table."""

    def chosen(self) -> tuple[Routine, ...]:
        """Return the rows that were asked for."""
        return named(self.routines(), self.only)


def stress(args: StressArguments, program: str, inputs: Sequence[Input], arguments: Sequence[str]) -> int:
    """Make the table, print and write it; returns the exit code: 1 where a cell fails."""
    typed = shlex.join([program, "stress", *arguments])
    if args.markdown is not None:
        page.around(args.markdown, f"{program} stress")  # before minutes of work
    if args.modes:
        tables = modes.in_each(program, _repeated(args), lambda mode: err.print(f"CPU mode {mode} ..."))
    else:
        chosen = args.chosen()
        with args.limited(), progress("routines", len(chosen)) as step:
            tables = [make(chosen, inputs, step)]
    _print(args, tables)
    if args.markdown is not None:
        page.put_into(args.markdown, f"{program} stress", page.markdown(tables, typed))
        err.print(f"wrote {args.markdown}")
    return DATA_ERROR if any(table.failures for table in tables) else 0


def _print(args: StressArguments, tables: Sequence[Table]) -> None:
    if args.json:
        out.write(json.dumps(tables[0].record(), indent=1) + "\n")
        return
    out.write("\n".join(page.text(table) for table in tables))


def _repeated(args: StressArguments) -> list[str]:
    """Return the flags that a run in another mode needs too."""
    flags = ["--only", *args.only] if args.only else []
    return [*flags, *(["--threads", str(args.threads)] if args.threads is not None else [])]
