"""The plan of a drive: what it has, what methods need and take, what can be left out, which prior it should have."""

from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from priors.bench.budget import Budget
from priors.bench.candidates import Candidate, candidates
from priors.errors import DataError
from priors.plan.needs import Has, Need, has, needs
from priors.plan.skips import Skip, skips
from priors.plan.way import open_some
from priors.plan.wish import Aim, PriorChoice, choose_prior
from priors.selection import select
from priors.types import Drive


@dataclass(frozen=True)
class Wish:
    """What a drive's priors are for."""

    dense_views: bool = False
    """Whether all views train a field; else few."""
    aim: Aim = "geometry"
    """What is wanted of it."""
    budget: Budget | None = None
    """What a frame may take."""


@dataclass(frozen=True)
class DrivePlan:
    """What is known of a drive before anything is built."""

    drive: str
    frames: int
    """Of the drive, or of the range that was asked for."""
    has: Has
    needs: tuple[Need, ...]
    candidates: tuple[Candidate, ...]
    """What can be built, the fastest first."""
    skips: tuple[Skip, ...]
    choice: PriorChoice | None
    """None where the budget cannot be kept."""
    unmet: str = ""
    """Why it cannot."""

    def seconds(self, candidate: Candidate) -> float:
        """Return what a candidate takes for the frames that add something, by one frame after the other."""
        adds_nothing = sum(skip.share for skip in self.skips if skip.what == "frames that add nothing")
        return candidate.seconds * self.frames * (1 - adds_nothing)

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return {
            "drive": self.drive,
            "frames": self.frames,
            "size": list(self.has.size),
            "has": self.has.shares | {"poses": self.has.posed},
            "methods": [asdict(need) for need in self.needs],
            "candidates": [self._candidate(each) for each in self.candidates],
            "skips": [asdict(skip) for skip in self.skips],
            "prior": None if self.choice is None else self._choice(self.choice),
            "unmet": self.unmet,
        }

    def _candidate(self, each: Candidate) -> dict[str, Any]:
        numbers = {"seconds": each.seconds, "abs_rel": each.abs_rel, "density": each.density}
        told = {name: value if value == value else None for name, value in numbers.items()}  # NaN is no JSON
        return {
            "name": each.name,
            "flags": each.flags(),
            "source": each.source,
            "seconds_in_all": self.seconds(each),
        } | told

    @staticmethod
    def _choice(choice: PriorChoice) -> dict[str, Any]:
        flags = [] if choice.candidate is None else choice.candidate.flags()
        return {"name": choice.name, "flags": flags, "reason": choice.reason, "evidence": choice.evidence}


def make_plan(drive: Drive, frames: str | None, cache: Path, wish: Wish, held_out: Collection[int] = ()) -> DrivePlan:
    """Look at a drive, and say what it needs and what it does not.

    Args:
        drive: the drive.
        frames: a range a:b, or None.
        cache: where its priors and its bench may lie.
        wish: what the priors are for.
        held_out: positions among the frames that a fit holds out.

    Raises:
        DataError: no frame can be opened.
    """
    indices = select(drive.ids, frames)
    can_build = candidates(drive, open_some(drive, indices)[0], cache)
    choice, unmet = None, ""
    try:
        choice = choose_prior(can_build, wish.dense_views, wish.aim, wish.budget)
    except DataError as error:
        unmet = str(error)
    left_out = skips(drive, indices, cache, held_out)
    found = has(drive, indices)
    return DrivePlan(
        drive.name, len(indices), found, tuple(needs(drive, indices)), tuple(can_build), tuple(left_out), choice, unmet
    )
