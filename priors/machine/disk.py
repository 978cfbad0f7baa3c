"""Disk space: told before anything is written, where there is too little of it."""

import shutil
from pathlib import Path

from priors.errors import DataError

WORTH_TELLING = 10**9
"""Bytes from which on a command says what it will take."""
UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB")


def free_bytes(folder: Path) -> int:
    """Return how much the disk of a folder has left; the folder need not be there yet."""
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    return shutil.disk_usage(there).free


def expect_room(folder: Path, needed: int, what: str) -> None:
    """Raise DataError where a folder's disk has less left than what is going to be written.

    Args:
        folder: where it is going to be written.
        needed: how much, bytes.
        what: what it is, in the plural.
    """
    free = free_bytes(folder)
    if needed > free:
        raise DataError(
            f"{folder}: {what} take about {size(needed)}, and its disk has {size(free)} left: "
            "free some, name a folder on another disk, or take fewer --frames"
        )


def told(folder: Path, needed: int, what: str) -> str | None:
    """Return the line that says what is going to be taken; None where it is little."""
    if needed < WORTH_TELLING:
        return None
    return f"disk: {what} take about {size(needed)} in {folder}, which has {size(free_bytes(folder))} left"


def size(count: float) -> str:
    """Write a number of bytes as people read it: 1.2 GB."""
    for unit in UNITS[:-1]:
        if count < 999.5:
            return f"{count:.0f} {unit}" if count >= 99.5 or unit == "bytes" else f"{count:.2g} {unit}"
        count /= 1000
    return f"{count:.3g} {UNITS[-1]}"
