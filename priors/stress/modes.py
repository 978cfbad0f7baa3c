"""The table in each CPU mode: a mode is chosen as a process begins, so that each has one of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence

from priors.errors import DataError
from priors.machine import cpu
from priors.stress.table import Table


def in_each(program: str, arguments: Sequence[str], tell: Callable[[str], None]) -> list[Table]:
    """Run `PROGRAM stress --json ARGUMENTS` in every mode that this CPU has; tells each mode before it begins."""
    tables = []
    for mode in cpu.supported():
        tell(mode)
        tables.append(_in_one(program, arguments, mode))
    return tables


def _in_one(program: str, arguments: Sequence[str], mode: str) -> Table:
    code = f"import sys; from cli.{program} import main; main()"
    command = [sys.executable, "-c", code, "stress", "--json", *arguments]
    done = subprocess.run(
        command, env={**os.environ, cpu.VARIABLE: mode}, stdout=subprocess.PIPE, text=True, check=False
    )
    try:
        return Table.read(json.loads(done.stdout))
    except ValueError as error:
        raise DataError(f"{program} stress in mode {mode} gave no table (exit code {done.returncode})") from error
