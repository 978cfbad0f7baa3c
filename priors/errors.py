"""The errors that a user reads: DataError, and UsageError where a command was called wrongly."""

from dataclasses import fields
from typing import Literal, get_args, get_origin

from eval.errors import DataError as DataError

LARGEST_SEED = 2**63 - 1
"""Seeds are whole numbers from 0 to this."""


MENDS = {
    PermissionError: "you may not read it: chmod u+r lets you",
    IsADirectoryError: "it is a folder: name a file",
}
"""What to do about a file that cannot be read, by the kind of the system's error."""


def unreadable(path: object, error: OSError, lost: str = "") -> DataError:
    """Return the error to raise where a file could not be read: which file, the system's reason, and what to do.

    `lost` says what to do where there is no such file.
    """
    if isinstance(error, FileNotFoundError):
        return DataError(f"{path}: no such file" + (f": {lost}" if lost else ""))
    mend = next((mend for kind, mend in MENDS.items() if isinstance(error, kind)), "copy or download it again")
    return DataError(f"{path}: cannot be read ({error.strerror or error}): {mend}")


class UsageError(DataError):
    """A command that was called wrongly; the command line exits 2."""


def expect(holds: bool, flag: str, value: object, wanted: str) -> None:
    """Raise unless a setting's condition holds: '--lidar.sweeps 0: expected 1 or more'.

    It is a UsageError where the setting is a flag, else a DataError.

    Args:
        holds: the condition; write it so that NaN makes it false.
        flag: the setting as the command line has it.
        value: what was given.
        wanted: what would be right.
    """
    if not holds:
        raise (UsageError if flag.startswith("--") else DataError)(f"{flag} {value}: expected {wanted}")


def expect_between(least: int, value: int | None, most: int, flag: str) -> None:
    """Raise as `expect` does unless a whole number lies between two others, both included; None is no number.

    The largest is far beyond what is of use: with it a slip of the keys (a date, a pasted number) is told at once, and
    does not fill the memory.
    """
    expect(value is None or least <= value <= most, flag, value, f"a whole number from {least} to {most}")


def expect_choices(config: object, prefix: str) -> None:
    """Raise UsageError where a field of a config dataclass is not one of its type's literals.

    The command line checks this itself; a config that is made in Python has no other guard.
    """
    for field in fields(config):  # type: ignore[arg-type]
        choices = get_args(field.type) if get_origin(field.type) is Literal else ()
        value = vars(config)[field.name]
        if choices and value not in choices:
            flag = f"--{prefix}{field.name.replace('_', '-')}"
            raise UsageError(f"{flag} {value}: expected one of {', '.join(map(str, choices))}")


def told(error: Exception) -> str:
    """Say in one line what is wrong: the system's errors with their file."""
    return f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
