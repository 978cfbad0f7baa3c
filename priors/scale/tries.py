"""Tries: how often a frame was begun and not ended, because its process died with it.

    <prior>/tries/<frame id>        a number: written before the frame is computed, deleted after it

A frame that ends its process (a library's fault, not enough memory) would end every process that it is given to.
After MOST of them it is reported as failed, and the others go on. A frame that was in hand on a node that died for
another reason has a try less, and is computed elsewhere.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from eval.files import write_bytes
from priors.errors import DataError
from priors.types import Depth, Frame

FOLDER = "tries"
MOST = 3
"""So many processes may die with a frame."""


def guarded(make_depth: Callable[[Frame], Depth], prior: Path) -> Callable[[Frame], Depth]:
    """Return a function that makes depth, counts its tries, and raises DataError in place of any other error.

    Args:
        make_depth: the method.
        prior: the prior's folder.
    """

    def make(frame: Frame) -> Depth:
        path = prior / FOLDER / frame.id
        before = _count(path)
        if before >= MOST:
            raise DataError(f"frame {frame.id}: {before} processes died with it: out of memory, or a library's fault")
        write_bytes(path, str(before + 1).encode())
        try:
            return make_depth(frame)
        except DataError:
            raise
        except Exception as error:  # one frame of a million must not end the others
            raise DataError(f"frame {frame.id}: {type(error).__name__}: {str(error).partition(chr(10))[0]}") from error
        finally:
            path.unlink(missing_ok=True)

    return make


def forget(prior: Path) -> None:
    """Begin to count anew: a build that is asked for again tries all frames again."""
    with suppress(OSError):
        for path in (prior / FOLDER).iterdir():
            path.unlink(missing_ok=True)
        (prior / FOLDER).rmdir()


def _count(path: Path) -> int:
    try:
        return int(path.read_text("utf-8"))
    except (OSError, ValueError):
        return 0
