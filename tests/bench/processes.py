"""Processor time of this process and all below it, from /proc; and the end of a branch of them."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

TICK_S = 1 / os.sysconf("SC_CLK_TCK")
PARENT, OWN, WAITED = 1, slice(11, 13), slice(13, 15)
"""Places in /proc/PID/stat, after the program's name."""


def stat(pid: int) -> list[str]:
    """Return what the system says of a process, after its name; nothing where it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    except OSError:
        return []


def below(pid: int) -> list[int]:
    """List the processes below one."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        fields = stat(int(entry.name))
        if fields:
            children.setdefault(int(fields[PARENT]), []).append(int(entry.name))
    found, level = [], [pid]
    while level:
        level = [child for parent in level for child in children.get(parent, [])]
        found += level
    return found


def spent_s(pids: list[int]) -> float:
    """Return the processor time of processes, and of those below them that ended and were waited for."""
    return sum(sum(map(int, [*fields[OWN], *fields[WAITED]])) * TICK_S for pid in pids if (fields := stat(pid)))


def processor_s() -> float:
    """Return the processor time of this process and all below it."""
    return time.process_time() + spent_s(below(os.getpid()))


def kill(pids: list[int]) -> None:
    """End processes at once, as a node that loses its power does."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
