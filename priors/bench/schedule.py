"""Schedule: how many frames each method makes, so that a bench ends in time. Slow methods make fewer."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Need:
    """What an entrant still has to do."""

    frames: int
    """Maps that are wanted."""
    seconds: float
    """Of one map."""
    cold_s: float
    """Of the first, which is not counted."""


@dataclass(frozen=True)
class Schedule:
    """What a bench will do."""

    frames: Mapping[str, int]
    """Maps of each entrant; at least one of each."""
    seconds: float
    """All of it, about."""
    shortened: tuple[str, ...]
    """Those that make fewer than were wanted."""


def schedule(needs: Mapping[str, Need], limit_s: float) -> Schedule:
    """Share the time out: every entrant gets as much, and what a fast one does not need goes to the others.

    Args:
        needs: of each entrant, by name; an entrant that needs nothing is left out.
        limit_s: seconds in all. One map of each is made even where they take longer.
    """
    cold_s = sum(need.cold_s for need in needs.values())
    share_s = _level(sorted(need.frames * need.seconds for need in needs.values()), limit_s - cold_s)
    frames = {name: _fitting(need, share_s) for name, need in needs.items()}
    seconds = cold_s + sum(frames[name] * need.seconds for name, need in needs.items())
    return Schedule(frames, seconds, tuple(name for name, need in needs.items() if frames[name] < need.frames))


def _fitting(need: Need, share_s: float) -> int:
    """Return how many of the frames that an entrant wants fit into its share; one is always made."""
    if need.frames * need.seconds <= share_s:
        return need.frames
    return max(1, int(share_s / need.seconds))


def _level(wanted: list[float], room: float) -> float:
    """Return the level up to which ascending amounts are filled so that they take the room; infinite where all fit."""
    for number, amount in enumerate(wanted):
        left = len(wanted) - number
        if amount * left > room:
            return max(0.0, room / left)
        room -= amount
    return float("inf")
