"""Checks before any work that the file or the folder that a command will write can be written."""

import tempfile
from collections.abc import Collection
from pathlib import Path

from priors.errors import UsageError


def expect_file(flag: str, path: Path, suffixes: Collection[str] = ()) -> None:
    """Raise UsageError unless a file can be written at path; the folders above it may be missing.

    Args:
        flag: what asked for it, for example --save.
        path: where it goes.
        suffixes: what its name may end in; none: anything.
    """
    if suffixes and path.suffix not in suffixes:
        raise UsageError(f"{flag} {path}: expected a name that ends in {', '.join(suffixes)}")
    if path.is_dir():
        raise UsageError(f"{flag} {path}: is a folder: name a file in it")
    _expect_room(flag, path, path.parent)


def expect_folder(flag: str, path: Path) -> None:
    """Raise UsageError unless files can be written into a folder; it may be missing, and so may those above it."""
    _expect_room(flag, path, path)


def _expect_room(flag: str, path: Path, folder: Path) -> None:
    """Raise UsageError unless a file can be made in a folder, or in the nearest one above that is there.

    It is tried: permissions do not say it of a file system that is read-only, or of a user who may do all.
    """
    there = next(above for above in (folder, *folder.absolute().parents) if above.exists())
    if not there.is_dir():
        raise UsageError(f"{flag} {path}: {there} is a file, not a folder")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise UsageError(f"{flag} {path}: {there} cannot be written ({error.strerror}): name another place") from error
