"""A program with commands: finds the command's file, imports it when it is named, tells the rest."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version

from cli.console import USAGE_ERROR, err, guarded, out


@dataclass(frozen=True)
class Program:
    """One of the installed programs."""

    name: str
    purpose: str
    commands: Mapping[str, tuple[str, str]]
    """Command -> module of this package that has its `run(arguments)`, and what it does."""
    examples: str

    def main(self) -> None:
        """Run with the process's arguments and exit."""
        raise SystemExit(self.run(sys.argv[1:]))

    def run(self, arguments: list[str]) -> int:
        """Run with the arguments; returns the exit code."""
        if not arguments or arguments[0] in ("-h", "--help"):
            out.print(self._overview(), markup=False)
            return 0
        if arguments[0] == "--version":
            out.print(f"roadprior {version('roadprior')}")
            return 0
        name, rest = arguments[0], arguments[1:]
        if name not in self.commands:
            err.print(f"[bold red]error:[/] no command {name!r}: choose one of {', '.join(self.commands)}")
            return USAGE_ERROR
        return guarded(lambda: import_module(self.commands[name][0]).run(rest))

    def _overview(self) -> str:
        rows = "\n".join(f"  {name:<8}{what}" for name, (_, what) in self.commands.items())
        parts = (
            f"{self.name}: {self.purpose}",
            f"commands\n{rows}",
            f"examples\n{self.examples}",
            f"{self.name} COMMAND --help tells the rest",
        )
        return "\n\n".join(parts)
