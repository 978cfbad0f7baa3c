"""Marks: when a fit is scored, after so much training or so many steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from nerf.config import FitConfig
from nerf.fit import Status
from priors.errors import UsageError


@dataclass(frozen=True, order=True)
class Mark:
    """A place on the course of a fit."""

    amount: float
    """Seconds of training, or steps."""
    unit: Literal["s", "steps"] = "s"

    def __str__(self) -> str:
        return f"{self.amount:g} {self.unit}"

    def reached(self, status: Status) -> bool:
        """Tell whether a fit has come this far."""
        return (status.elapsed_s if self.unit == "s" else status.step) >= self.amount

    def budget(self, fit: FitConfig) -> FitConfig:
        """Return the settings of a fit that ends here."""
        if self.unit == "s":
            return replace(fit, steps=None, seconds=self.amount)
        return replace(fit, steps=round(self.amount), seconds=None)


READY = Mark(0, "steps")
"""Where a field is scored that is not trained."""


def ascending(marks: Sequence[Mark]) -> tuple[Mark, ...]:
    """Sort marks of one unit, each once; UsageError where there is none."""
    if not marks:
        raise UsageError("--at: expected one time or more, for example --at 10s 30s 60s")
    return tuple(sorted(set(marks)))
