"""What came of each drive of a build: parts that add up, one table, and summary.json in the cache."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from eval.files import write_bytes
from priors.build import BuildReport, Plan
from priors.build.plan import CACHED
from priors.cache import Prior
from priors.cache.store import mirror, publish

NAME = "summary.json"
FORMAT = 1
SUMS = ("todo", "cached", "skipped", "done", "built", "seconds", "density")
"""What is added up."""


@dataclass(frozen=True)
class Part:
    """What came of some frames of a drive, or of its plan."""

    drive: int
    """Which of the command's drives."""
    folder: str = ""
    """The prior's folder; only a plan says it."""
    todo: int = 0
    """Frames that are going to be computed."""
    cached: int = 0
    """Frames that were there."""
    skipped: int = 0
    """Frames that lack an input or stood still."""
    done: int = 0
    """Frames of `todo` that are built, have failed, or were made by another build."""
    built: int = 0
    seconds: float = 0.0
    """Sum of what the built frames took."""
    density: float = 0.0
    """Sum of the built frames' densities."""
    failed: Mapping[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""
    error: str = ""
    """Why nothing can be built of the drive."""

    def __add__(self, other: Self) -> Self:
        """Return what came of the frames of both; drive, folder and error are the other's where it says them."""
        sums = {name: getattr(self, name) + getattr(other, name) for name in SUMS}
        folder, error = other.folder or self.folder, other.error or self.error
        return replace(other, **sums, folder=folder, failed={**self.failed, **other.failed}, error=error)

    @property
    def left(self) -> int:
        """Frames of `todo` that were not reached."""
        return max(self.todo - self.done, 0)

    def means(self) -> dict[str, float | None]:
        """Return seconds and density of a built frame; None where there is none."""
        return {name: getattr(self, name) / self.built if self.built else None for name in ("seconds", "density")}

    def pack(self) -> str:
        """Return it as JSON; `unpack` undoes it."""
        return json.dumps(asdict(self))

    @classmethod
    def unpack(cls, text: str) -> Self:
        """Return what `pack` was given."""
        return cls(**json.loads(text))

    @classmethod
    def of_plan(cls, drive: int, prior: Prior, plan: Plan) -> Self:
        """Tell what a plan says."""
        cached = sum(reason == CACHED for reason in plan.skipped.values())
        skipped = len(plan.skipped) - cached
        return cls(drive, str(prior.folder), len(plan.todo), cached, skipped, failed=dict(plan.failed))

    @classmethod
    def of_report(cls, drive: int, report: BuildReport) -> Self:
        """Tell what became of the frames of a plan, each of which was told as done, and the plan's own failures too."""
        failed = {id_: why for id_, why in report.failed.items() if id_ not in report.plan.failed}
        built = [str(line["id"]) for line in report.built] + report.left
        return replace(cls.of_frames(drive, report.prior, built, failed), done=0)

    @classmethod
    def of_frames(cls, drive: int, prior: Prior, built: Sequence[str], failed: Mapping[str, str]) -> Self:
        """Tell of frames that were planned: those that are built now, by whomever, and those that failed."""
        seconds, density = (sum(prior.figures(name, built)) for name in ("seconds", "density"))
        done = len(built) + len(failed)
        return cls(drive, done=done, built=len(built), seconds=seconds, density=density, failed=failed)


@dataclass
class Tally:
    """What came of one drive: its parts, added up."""

    name: str
    """What tables call it."""
    place: str
    """Where it is."""
    part: Part = Part(0)
    """All of them together."""

    def add(self, part: Part) -> None:
        """Take a part in."""
        self.part += part

    @property
    def is_whole(self) -> bool:
        """Whether nothing failed."""
        return not self.part.error and not self.part.failed and not self.part.left

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it; seconds and density are means over the built frames, None where there is none."""
        added = {name: value for name, value in asdict(self.part).items() if name != "drive"}
        left = {"unfinished": self.part.left} if self.part.left else {}
        return {"name": self.name, "place": self.place, **added} | self.part.means() | left


def write_summary(cache: Path, command: str, tallies: Sequence[Tally]) -> Path:
    """Write summary.json into a cache; returns its path.

    Raises:
        OSError: it cannot be written.
    """
    path = mirror(cache) / NAME
    content = {"format": FORMAT, "command": command, "drives": [tally.record() for tally in tallies]}
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())
    publish(path)
    return path
