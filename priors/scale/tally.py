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
    """What came of one drive."""

    name: str
    """What tables call it."""
    place: str
    """Where it is."""
    folder: str = ""
    todo: int = 0
    cached: int = 0
    skipped: int = 0
    done: int = 0
    built: int = 0
    seconds: float = 0.0
    density: float = 0.0
    failed: dict[str, str] = field(default_factory=dict)
    error: str = ""

    def add(self, part: Part) -> None:
        """Take a part in."""
        for name in ("todo", "cached", "skipped", "done", "built", "seconds", "density"):
            setattr(self, name, getattr(self, name) + getattr(part, name))
        self.failed.update(part.failed)
        self.folder, self.error = part.folder or self.folder, part.error or self.error

    @property
    def is_whole(self) -> bool:
        """Whether nothing failed."""
        return not self.error and not self.failed and self.done >= self.todo

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it; seconds and density are means over the built frames, None where there is none."""
        means = {name: getattr(self, name) / self.built if self.built else None for name in ("seconds", "density")}
        left = {"unfinished": self.todo - self.done} if self.done < self.todo else {}
        return asdict(self) | means | left


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
