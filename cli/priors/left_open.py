"""Chooses the method of a build where the user names none: `--method auto`, `--budget`, or no flag."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cli.console import busy, err
from priors import methods
from priors.bench.budget import Budget, told
from priors.bench.candidates import Candidate, candidates
from priors.bench.entrants import CHOICES
from priors.errors import UsageError
from priors.plan.way import advise_method, open_some
from priors.types import Drive


@dataclass(frozen=True)
class Chosen:
    """A method, and the settings that were chosen with it."""

    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class LeftOpen:
    """A build whose method is to be found."""

    drive: Drive
    indices: Sequence[int]
    """Of the frames that are asked for."""
    cache: Path
    """Where the drive's bench may lie."""
    typed: Sequence[str]
    """The command's words."""

    def for_budget(self, budget: Budget, method: str | None) -> Chosen:
        """Choose for a budget, among a method's settings where the user names it; say what and why."""
        for flag in (word.partition("=")[0] for word in self.typed):
            _, _, name = flag.partition(".")
            if method_of(flag) is not None and name in CHOICES:
                raise UsageError(f"{flag}: --budget chooses it: leave out one or the other")
        with busy("looking for what keeps to the budget"):
            every = candidates(self.drive, open_some(self.drive, self.indices)[0], self.cache)
        among = [each for each in every if method in (None, each.method.name)]
        if method is not None and not among:
            raise UsageError(f"--budget {budget}: what {method} takes here is not known: run `priors bench` first")
        return self._say(budget.choose(among, named=method is not None), f"the best for {budget}")

    def for_drive(self, asked: bool) -> Chosen:
        """Choose what suits the drive; UsageError tells it where the user did not ask for that."""
        advice = advise_method(self.drive, self.indices, self.cache)
        if not asked:
            has = " and ".join(filter(None, (", ".join(advice.has[:-1]), *advice.has[-1:]))) or "images alone"
            command = shlex.join(["priors", "build", *self.typed, "--method", advice.method])
            told = f"{self.drive.name} has {has}; --method auto takes {advice.method}: {command}"
            raise UsageError(f"--method is missing: {told}")
        if advice.candidate is not None:
            return self._say(advice.candidate, advice.reason)
        err.print(f"method: {advice.method}: {advice.reason}")
        self._tell_idle(advice.method)
        return Chosen(advice.method)

    def _say(self, chosen: Candidate, why: str) -> Chosen:
        """Say what was chosen, and what to expect of it."""
        error = f", AbsRel {chosen.abs_rel:.4f}" if chosen.abs_rel == chosen.abs_rel else ""
        err.print(f"method: {chosen.name}: {why}: {told(chosen.seconds)} a frame{error}, {chosen.source}")
        self._tell_idle(chosen.method.name)
        return Chosen(chosen.method.name, chosen.changes)

    def _tell_idle(self, method: str) -> None:
        for flag in idle_flags(method, self.typed):
            err.print(f"{flag}: not used by {method}")


def idle_flags(method: str, typed: Sequence[str]) -> list[str]:
    """Return the flags that were typed of other methods than this."""
    flags = dict.fromkeys(word.partition("=")[0] for word in typed if word.startswith("--"))
    return [flag for flag in flags if method_of(flag) not in (None, method)]


def method_of(flag: str) -> str | None:
    """Return the method whose flag this is, as --stereo.model is stereo's; None for those of the command."""
    name, dot, _ = flag.removeprefix("--").replace("-", "_").partition(".")
    return name if dot and name in methods.names() else None
