"""The drives of a command, each opened once: which are there, which are named twice."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from priors import drives
from priors.errors import DataError
from priors.scale.drive_list import DriveEntry
from priors.types import Drive, Method

AT_ONCE = 16
"""Drives that are opened side by side: on a file server each waits for its files."""
Choose = Callable[[DriveEntry, Drive], Method]
"""Returns the method for a drive, which is closed then; DataError where it cannot be used."""


@dataclass(frozen=True)
class Member:
    """A drive that is there."""

    entry: DriveEntry
    name: str
    """The drive's own: its folder's name in the cache."""
    camera: str
    method: Method


@dataclass(frozen=True)
class Fleet:
    """Drives that were opened, in the order in which they were named, and those that cannot be used."""

    members: list[Member] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    """Place -> why."""


def gather(entries: Sequence[DriveEntry], choose: Choose) -> Fleet:
    """Open each drive and ask for its method; what is missing or has another's name is refused, the rest goes on.

    Maps of one drive lie in one folder of the cache, named after it. Two cameras of a drive are two priors there.
    """
    with ThreadPoolExecutor(AT_ONCE) as pool:
        opened = list(pool.map(lambda entry: _open(entry, choose), entries))
    fleet, homes, taken = Fleet(), dict[str, Path](), set[tuple[str, str, str | None]]()
    for entry, member in zip(entries, opened, strict=True):
        if isinstance(member, DataError):
            fleet.refused[str(entry.path)] = str(member).removeprefix(f"{entry.path}: ")
            continue
        home = entry.path.resolve()
        if homes.setdefault(member.name, home) != home:
            other = f"its name, {member.name}, is also that of {homes[member.name]}"
            fleet.refused[str(entry.path)] = f"{other}: build it into a cache of its own (--cache)"
            continue
        key = member.name, member.camera, entry.frames
        if key in taken:  # a pattern and a list may name it both
            continue
        taken.add(key)
        fleet.members.append(member)
    return fleet


def _open(entry: DriveEntry, choose: Choose) -> Member | DataError:
    try:
        drive = drives.open_drive(entry.path, entry.dataset, entry.part)
        return Member(entry, drive.name, str(drive.describe().get("camera")), choose(entry, drive))
    except DataError as error:
        return error
