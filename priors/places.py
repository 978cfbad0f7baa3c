"""Places: the drives in and below a folder, for commands that were told no DATA.

    the_place(Path(".")).path        the drive here, or the only one at most three folders down

A place is a drive's own folder: a KITTI date with several drives is several places.
"""

import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from priors import drives
from priors.drives import subfolders
from priors.errors import UsageError

LEVELS = 3
"""How far below the folder DATA may be; the levels of a data set's own layout come on top."""
SKIPPED = ("cache", "runs")
"""Folders of our own, where no drives are; those whose names begin with a dot are not looked into either."""
MOST = 10_000
"""Folders that are looked at, the nearest first: a whole disk must not be walked."""
SHOWN = 10
"""Places that an error lists."""


@dataclass(frozen=True)
class Place:
    """Where a drive is."""

    path: Path
    """The drive's folder, from where it was looked for."""
    dataset: str
    """The data set that knows its layout."""


@dataclass(frozen=True)
class _Layout:
    """What one data set's drives look like."""

    dataset: str
    levels: int
    """Between its folder and its drives."""
    fits: Callable[[Path], bool]
    """Tells whether a folder is itself a drive."""


def places(folder: Path, drive: str | None = None) -> list[Place]:
    """List the drives in a folder: itself, or all that lie below it; by one's name only, where it is given.

    Raises:
        UsageError: there are too many folders to look at.
    """
    layouts = [_layout(name) for name in drives.names()]
    found: dict[str, Place] = {}
    for path, level in _walk(folder, max(layout.levels for layout in layouts), found):
        for layout in layouts:
            if level <= LEVELS + layout.levels and layout.fits(path):
                found.setdefault(os.path.realpath(path), Place(path, layout.dataset))  # a link and its target are one
                break
    return [place for place in found.values() if drive is None or place.path.absolute().name == drive]


def the_place(folder: Path, drive: str | None = None, typed: Sequence[str] = ()) -> Place:
    """Return the only drive in a folder or below it.

    Args:
        folder: where to look.
        drive: only a drive of this name counts.
        typed: program, command and flags; an error shows how to go on with them.

    Raises:
        UsageError: there is none, or more than one: they are listed, as commands to copy.
    """
    found = places(folder, drive)
    if len(found) == 1:
        return found[0]
    where = f"in {folder.absolute()} and {LEVELS} folders down"
    if not found:
        named = "no drive" if drive is None else f"no drive {drive!r}"
        street = "`priors street street/` makes the embedded one"
        raise UsageError(f"{named} {where}: name its folder, or begin without a download: {street}")
    raise UsageError(f"{len(found)} drives {where}: name one:{_listed(found, typed)}")


def _layout(dataset: str) -> _Layout:
    """Ask a data set's reader; one that says nothing of levels takes for a drive what it recognises."""
    reader = drives.reader(dataset)
    return _Layout(dataset, getattr(reader, "BELOW", 0), getattr(reader, "is_drive", reader.recognises))


def _walk(folder: Path, extra: int, found: dict[str, Place]) -> Iterator[tuple[Path, int]]:
    """Yield a folder and those below it with their levels, the nearest first; what lies in a drive is left out."""
    seen, level = 0, [folder]
    for number in range(LEVELS + extra + 1):
        below: list[Path] = []
        for path in level:
            seen += 1
            if seen > MOST:
                if number > LEVELS:
                    return
                raise UsageError(f"{folder.absolute()}: more than {MOST:,} folders in it: name the drive's folder")
            yield path, number
            if os.path.realpath(path) not in found:
                below += [inner for inner in subfolders(path) if inner.name not in SKIPPED]
        level = below


def _listed(found: Sequence[Place], typed: Sequence[str]) -> str:
    """List places, each as the command that names it; a number for each where no command was given."""
    lines = [shlex.join([*typed[:2], str(place.path), *typed[2:]]) for place in found[:SHOWN]]
    more = [f"... and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    return "".join(f"\n  {line}" for line in [*lines, *more])
