"""Findings: what an audit says, one line each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "note", "warning", "fatal"]


@dataclass(frozen=True)
class Finding:
    """One line of the audit."""

    level: Level
    """ok; note: missing, and fine if not needed; warning: look at it; fatal: maps would be wrong or not made."""
    subject: str
    """calibration, frames, files, stereo, poses, times, lidar, truth or sparse."""
    message: str
    """What was found and, where it is wrong, what to do."""


def some(names: Sequence[str]) -> str:
    """Return the first few names, for a message."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
