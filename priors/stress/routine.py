"""Routines under stress: what a row of the table runs, and what it is compared with."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from priors.errors import UsageError
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.tolerances import PrecisionName

Outputs: TypeAlias = Mapping[str, Any]
"""Results by name: arrays or numbers."""


@dataclass(frozen=True, slots=True)
class Gradient:
    """A gradient that the routine computes, and the function that it is the gradient of."""

    found: Callable[[], Outputs]
    """The routine's gradients by the arguments' names."""
    loss: Callable[[Mapping[str, Floats]], Any]
    """The function in float64, of arguments by name: a number, or parts (n,) whose sum it is, they keep more digits."""
    at: Mapping[str, Floats]
    """The arguments."""
    scale: Mapping[str, float] = field(default_factory=dict)
    """Natural scale of an argument's gradient; without one: its largest gradient."""
    smooth: Mapping[str, Any] = field(default_factory=dict)
    """Where an argument has a derivative, a mask; without one: everywhere. Elsewhere it is held, as nerf.types says."""


@dataclass(frozen=True, slots=True)
class Case:
    """A routine on one input."""

    found: Callable[[], Outputs]
    """What the routine answers."""
    wanted: Callable[[], Outputs]
    """What the formula says, in float64 or better; NaN and inf are answers too."""
    scale: Mapping[str, Any] = field(default_factory=dict)
    """Natural scale of a result, a number or an array; without one: the wanted result's own size."""
    gradient: Gradient | None = None
    raises: type[Exception] | None = None
    """The stated answer is this error."""
    spreads: bool = False
    """The stated answer to a value that is not finite: what depends on it is not finite either, all else is right.

    Without it NaN must be NaN, and infinity infinity."""


@dataclass(frozen=True, slots=True)
class Routine:
    """A row: one numerical routine, by the name under which users know it."""

    name: str
    where: str
    """The file that it stands in."""
    case: Callable[[Given], Case]
    senseless: Mapping[str, str] = field(default_factory=dict)
    """Why an input makes no sense here, by its name."""
    other_types: Mapping[PrecisionName, str] = field(default_factory=dict)
    """Why a precision makes no sense here, by its name."""


def named(routines: Sequence[Routine], names: Sequence[str]) -> tuple[Routine, ...]:
    """Return the routines whose names contain one of these words, all of them without any; in the table's order.

    Raises UsageError for a word that is in none, with the names.
    """
    for name in names:
        if not name or not any(name.lower() in routine.name.lower() for routine in routines):
            raise UsageError(f"--only {name}: no routine has that in its name: {', '.join(r.name for r in routines)}")
    chosen = [r for r in routines if not names or any(name.lower() in r.name.lower() for name in names)]
    return tuple(chosen)


def without(*names: str, why: str) -> dict[str, str]:
    """Say why inputs make no sense."""
    return dict.fromkeys(names, why)


NO_POSES = without("poses 5e5 m", why="it sees no pose")
NO_MASK = without("empty mask", why="it has no mask")
NO_DEPTH = without("1e-3 m", "1e6 m", why="it sees no depth")
FLOAT32_ONLY: dict[PrecisionName, str] = dict.fromkeys(("bf16", "fp16"), "it takes float32")
NO_BFLOAT: dict[PrecisionName, str] = {"bf16": "numpy has no bfloat16"}
NO_HALF: dict[PrecisionName, str] = {"fp16": "it takes float32 and bfloat16"}
