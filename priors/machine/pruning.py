"""Compiled kernels of earlier sources: what nobody used for a while is deleted."""

import os
import re
import shutil
import time
from contextlib import suppress
from pathlib import Path

KEPT = 4
"""So many of the folders last used stay, however old: a user may go back to an earlier version."""
UNUSED_S = 7 * 86400.0
"""Younger ones stay too: a process that runs may still fill them."""
NAME = re.compile(r"[a-z0-9_]+-[0-9a-f]{12}")


def mark_used(folder: Path) -> None:
    """Note in the folder's time that it is used now."""
    with suppress(OSError):
        os.utime(folder)


def prune(place: Path) -> None:
    """Delete the folders of compiled kernels in a place that were not used for UNUSED_S, but for the last KEPT.

    Only what is named like them is touched; what cannot be deleted stays.
    """
    with suppress(OSError):
        folders = [path for path in place.iterdir() if NAME.fullmatch(path.name) and path.is_dir()]
        used = sorted(((path.stat().st_mtime, path) for path in folders), reverse=True)
        for last, path in used[KEPT:]:
            if time.time() - last > UNUSED_S:
                shutil.rmtree(path, ignore_errors=True)
