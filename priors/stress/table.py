"""The table: every routine on every input in every precision. A cell holds a verdict, or why it makes no sense."""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Self, TypeAlias

import numpy as np

from priors.machine.cpu import mode
from priors.stress import tolerances
from priors.stress.inputs import Given, Input
from priors.stress.measure import Measured, measure
from priors.stress.precision import PRECISIONS, Precision
from priors.stress.routine import Routine
from priors.stress.tolerances import PrecisionName

Verdict: TypeAlias = Literal["ok", "fails", "no sense"]


@dataclass(frozen=True, slots=True)
class Cell:
    """One routine on one input in one precision."""

    routine: str
    input: str
    precision: PrecisionName
    verdict: Verdict
    value: float | None = None
    """Largest error of a value, of its natural scale."""
    gradient: float | None = None
    """Largest error of a gradient, of its natural scale."""
    why: str = ""
    """Why it makes no sense, what failed, or the stated answer."""


@dataclass(frozen=True, slots=True)
class Table:
    """All cells of a run."""

    mode: str
    """The CPU's mode."""
    cells: tuple[Cell, ...]

    @property
    def failures(self) -> list[Cell]:
        """The cells that fail."""
        return [cell for cell in self.cells if cell.verdict == "fails"]

    def of(self, routine: str, precision: str | None = None) -> list[Cell]:
        """Return the cells of a routine, in one precision or in all."""
        return [c for c in self.cells if c.routine == routine and precision in (None, c.precision)]

    def worst(self, routine: str, precision: str, what: Literal["value", "gradient"]) -> float | None:
        """Return the largest error of a routine in one precision; None where nothing was measured."""
        found = [getattr(cell, what) for cell in self.of(routine, precision)]
        return max((each for each in found if each is not None), default=None)

    def used(self, routine: str) -> float:
        """Return how much of its tolerance a routine uses at most: 1 is all of it."""
        limits = {"value": tolerances.VALUE, "gradient": tolerances.GRADIENT}
        shares = (
            (getattr(cell, what) or 0.0) / limit[cell.precision]
            for cell in self.of(routine)
            for what, limit in limits.items()
        )
        return max(shares, default=0.0)

    @property
    def routines(self) -> list[str]:
        """The routines' names, in order."""
        return list(dict.fromkeys(cell.routine for cell in self.cells))

    @classmethod
    def read(cls, record: dict[str, Any]) -> Self:
        """Take a table from what `record` made."""
        errors = ({name: _number(cell[name]) for name in ("value", "gradient")} for cell in record["cells"])
        cells = [Cell(**{**cell, **own}) for cell, own in zip(record["cells"], errors, strict=True)]
        return cls(record["cpu"], tuple(cells))

    def record(self) -> dict[str, Any]:
        """Return the table as JSON holds it; an infinite error is the text inf."""
        cells = [{k: "inf" if v == math.inf else v for k, v in asdict(cell).items()} for cell in self.cells]
        limits = {"value": tolerances.VALUE, "gradient": tolerances.GRADIENT}
        return {"cpu": self.mode, "tolerances": limits, "failures": len(self.failures), "cells": cells}


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def run(
    routines: Sequence[Routine], inputs: Sequence[Input], tell: Callable[[Routine], object] = lambda routine: None
) -> Table:
    """Run routines on inputs in all precisions; `tell` is called when one is done."""
    cells = []
    for routine in routines:
        cells += [cell(routine, input_, precision) for input_ in inputs for precision in PRECISIONS]
        tell(routine)
    return Table(mode(), tuple(cells))


def cell(routine: Routine, input_: Input, precision: Precision) -> Cell:
    """Run one cell; the same numbers each time."""
    name = routine.name, input_.name, precision.name
    why = routine.senseless.get(input_.name) or routine.other_types.get(precision.name)
    if why:
        return Cell(*name, "no sense", why=why)
    random = np.random.default_rng(zlib.crc32("/".join(name).encode()))
    given = Given(input_, precision, random)
    found = measure(routine.case(given), random)
    verdict: Verdict = "fails" if _fails(found, precision.name) else "ok"
    return Cell(*name, verdict, found.value, found.gradient, found.fault or found.stated)


def _fails(found: Measured, precision: PrecisionName) -> bool:
    value, gradient = found.value or 0.0, found.gradient or 0.0
    return bool(found.fault) or value > tolerances.VALUE[precision] or gradient > tolerances.GRADIENT[precision]
