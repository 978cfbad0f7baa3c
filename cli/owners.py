"""Which commands have a flag: for the message where it was given to another command.

Every command's file has `ARGUMENTS`: command -> the dataclass of its arguments.
"""

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from cli.renamed import flags_of, negated

PROGRAMS = ("priors", "nerf")
TRAIN = "priors train"
"""A command with commands of its own: outside of it they are named together."""
MOST_NAMED = 3
"""So many commands are named; the others are counted."""


def arguments_of(program: str) -> dict[str, type[Any]]:
    """Return the dataclass of each command's arguments, by the command as it is typed: `priors build`."""
    names = import_module(f"cli.{program}").PROGRAM.commands
    modules = (import_module(f"cli.{program}.{name}") for name in names)
    return {command: kind for module in modules for command, kind in module.ARGUMENTS.items()}


def commands_with(flag: str, command: str) -> list[str]:
    """Return the commands that have a flag, those of the same program as `command` first.

    Those that train come last, but for a command that trains itself.
    """
    trains = command.startswith(TRAIN)
    first = f"{TRAIN} " if trains else f"{command.split()[0]} "
    kinds = {name: kind for program in PROGRAMS for name, kind in arguments_of(program).items()}
    names = [name for name, kind in kinds.items() if flag in _flags(kind)]
    if not trains:
        names = list(dict.fromkeys(TRAIN if name.startswith(TRAIN) else name for name in names))
    return sorted(names, key=lambda name: (name == TRAIN, not name.startswith(first)))


def told(commands: Sequence[str]) -> str:
    """Say ': a flag of nerf fit and nerf study'; nothing where there is no command."""
    if not commands:
        return ""
    named, more = list(commands[:MOST_NAMED]), len(commands) - MOST_NAMED
    if more > 0:
        named.append(f"{more} more")
    listed = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
    return f": a flag of {listed}"


def program_with(name: str, program: str) -> str:
    """Return ': it is nerf fit' where another program has a command of this name; else nothing."""
    for other in PROGRAMS:
        if other != program and name in import_module(f"cli.{other}").PROGRAM.commands:
            return f": it is {other} {name}"
    return ""


def _flags(kind: type[Any]) -> Iterator[str]:
    for name in flags_of(kind):
        yield f"--{name}"
        yield f"--{negated(name)}"
