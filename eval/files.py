"""Atomic writes: a reader finds the old file or the whole new one, and a killed writer leaves no half file."""

import os
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

STALE_S = 3600.0
"""Age at which a temporary file is taken to be a killed run's: no other machine can still be writing it."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the block a temporary path beside `path`, with its suffix; rename it to `path` where the block succeeds.

    Where the block fails, the temporary file is deleted and what was at `path` stays.

    Raises:
        OSError: writing failed; the error names `path`, which a full disk's own error does not.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename not in (None, temporary, str(temporary)):
            raise  # of another file, which the block reads
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with suppress(OSError):  # a read-only disk: there is none, and the block's own error tells
            temporary.unlink(missing_ok=True)


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill the temporary file of `replacing`."""
    with replacing(path) as temporary:
        write(temporary)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    write_atomically(path, lambda temporary: temporary.write_bytes(data))


def drop_stale(folder: Path, pattern: str = ".*") -> None:
    """Delete temporary files in and below a folder, matching `pattern`, that are older than STALE_S."""
    for path in folder.rglob(pattern):
        with suppress(FileNotFoundError):  # another process drops them too, or has just finished one
            if path.is_file() and time.time() - path.stat().st_mtime > STALE_S:
                path.unlink()
