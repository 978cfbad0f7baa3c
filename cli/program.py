"""A program with commands: finds the command's file, imports it when it is named, tells the rest."""

import os
import platform
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from typing import Any

from cli import logs
from cli.console import USAGE_ERROR, busy, err, guarded, out
from cli.mistakes import nearest
from cli.owners import program_with
from cli.stand_ins import say_plainly
from priors.errors import DataError
from priors.machine import cpu
from priors.machine.memory import keep_freed


@dataclass(frozen=True)
class Program:
    """One of the installed programs."""

    name: str
    purpose: str
    commands: Mapping[str, str]
    """Command -> what it does. Its file, cli/<program>/<command>.py, has its `run(arguments)`."""
    examples: str

    def main(self) -> None:
        """Run with the process's arguments and exit; the process is ours, so that its memory is too."""
        say_plainly((sys.stdout, sys.stderr))
        keep_freed()
        raise SystemExit(self.run(sys.argv[1:]))

    def run(self, arguments: list[str]) -> int:
        """Run with the arguments; returns the exit code."""
        verbose = logs.VERBOSE in arguments or logs.DEBUG in arguments
        arguments = logs.taken(arguments)
        if not arguments or arguments[0] in ("-h", "--help"):
            out.print(self._overview())
            return 0
        if arguments[0] == "--version":
            out.print(f"roadprior {version('roadprior')}")
            if verbose:
                out.print("\n".join(_machine()))
            return 0
        name, rest = arguments[0], arguments[1:]
        if name not in self.commands:
            err.complain(self._unknown(name))
            return USAGE_ERROR
        if not {"-h", "--help"}.intersection(rest) and (wrong := _wrong_mode()):
            err.complain(wrong)
            return USAGE_ERROR
        return guarded(lambda: self._load(name).run(rest))

    def _load(self, name: str) -> Any:
        """Import a command's file: where PyTorch is read from a cold disk that takes a while. A pipe is not told."""
        with busy(f"loading {self.name} {name}") if err.moves else nullcontext():
            return import_module(f"cli.{self.name}.{name}")

    def _unknown(self, name: str) -> str:
        """Say which command may be meant by a word that is none."""
        if name.startswith("-"):
            return f"{self.name} {name}: a command comes first: {self.name} COMMAND {name}"
        elsewhere = program_with(name, self.name)
        choices = f": choose one of {', '.join(self.commands)}{nearest(name, list(self.commands))}"
        return f"{self.name} has no command {name!r}{elsewhere or choices}"

    def _overview(self) -> str:
        rows = "\n".join(f"  {name:<8}{what}" for name, what in self.commands.items())
        parts = (
            f"{self.name}: {self.purpose}",
            f"commands\n{rows}",
            f"examples\n{self.examples}",
            f"{self.name} COMMAND --help tells the rest\n"
            "every command takes --verbose (what goes on inside) and --debug (the traceback behind an error)",
        )
        return "\n\n".join(parts)


def _machine() -> list[str]:
    """Describe what runs here, as a report of a fault needs it."""
    import torch

    from priors.machine import threads

    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numpy", "numba", "onnxruntime"))
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    return [
        f"Python {platform.python_version()} on {platform.platform()}",
        packages,
        f"CPU mode {cpu.mode()}, {threads.count()} threads; GPU {gpu}",
    ]


def _wrong_mode() -> str:
    """Say what is wrong with the CPU mode that was asked for, before any work; nothing where it is right."""
    if not os.environ.get(cpu.VARIABLE):
        return ""
    try:
        cpu.mode()
    except DataError as error:
        return str(error)
    return ""
