"""Keeps freed memory for the next map: a fresh page of the system costs as much time as a network's layer."""

import ctypes
import sys
from functools import cache

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""glibc's names for what mallopt sets."""
KEPT_BYTES = 256 << 20
LARGEST_BYTES = 32 << 20
"""glibc takes no more: larger blocks come from the system each time."""


@cache
def keep_freed() -> bool:
    """Tell glibc to keep up to 256 MB of freed memory for the next frame; returns False where there is no glibc."""
    if sys.platform != "linux":
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(MMAP_THRESHOLD, LARGEST_BYTES)) and bool(mallopt(TRIM_THRESHOLD, KEPT_BYTES))
