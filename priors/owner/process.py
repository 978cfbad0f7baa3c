"""A process as others know it: its host, its number, and the launch that it belongs to."""

import os
import socket
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

HERE = ("127.0.0.1", "localhost", "::1", "0.0.0.0")
"""Addresses that mean another host on each host."""


@dataclass(frozen=True)
class Process:
    """What tells one process from all others, on this host and elsewhere."""

    host: str
    """Name of the computer."""
    space: str
    """The boot and the number space that `pid` counts in: two containers of one name have two."""
    pid: int
    started: str
    """When it started, in the system's own ticks: numbers of ended processes are given out again. Empty: not known."""
    launch: str = ""
    """What processes of one launch have in common (`torchrun`, several GPUs); empty for a process of its own."""

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it; `restore` undoes it."""
        return asdict(self)

    @property
    def is_me(self) -> bool:
        """Whether it is the process that asks."""
        return self == me(os.getpid())

    @property
    def is_partner(self) -> bool:
        """Whether it belongs to the launch of the process that asks: the two are one owner."""
        return bool(self.launch) and self.launch == me(os.getpid()).launch

    @property
    def has_ended(self) -> bool:
        """Whether it is known to have ended; False where this computer cannot know."""
        here = me(os.getpid())
        if (self.host, self.space) != (here.host, here.space):
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except OSError:
            pass  # somebody else's: it lives
        return bool(self.started) and _started(self.pid) != self.started

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


def restore(record: Any) -> Process | None:
    """Return the process of a record; None where it is none, perhaps a later version's."""
    try:
        found = Process(**record)
    except TypeError:
        return None
    return found if isinstance(found.pid, int) and found.pid > 0 else None


@cache
def me(pid: int) -> Process:
    """Return this process; `pid` is its own, so that a fork asks anew."""
    return Process(socket.gethostname(), _space(), pid, _started(pid), _launch())


def _space() -> str:
    """Name the boot and the process number space; empty where the system does not tell."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("utf-8").strip()
        return f"{boot}/{Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Return when a process started (field 22 of /proc/PID/stat), empty where that is not told or it is a zombie."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


def _launch() -> str:
    """Name the launch from what torchrun and its like tell each process; empty for a process of its own."""
    told = os.environ.get
    if not told("WORLD_SIZE", "1").isdecimal() or int(told("WORLD_SIZE", "1")) < 2:
        return ""
    address = told("MASTER_ADDR", "")
    where = socket.gethostname() if address in ("", *HERE) else address
    return "/".join([where, *(told(name, "") for name in ("MASTER_PORT", "TORCHELASTIC_RUN_ID", "SLURM_JOB_ID"))])
