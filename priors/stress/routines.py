"""All rows of `priors stress`, and how rows are found by name."""

from collections.abc import Sequence

from priors.errors import UsageError
from priors.stress import (
    accumulation,
    alignment,
    codecs,
    images,
    maps,
    metrics,
    projection,
    upsampling,
    volumes,
)
from priors.stress.routine import Routine

ROUTINES: tuple[Routine, ...] = (
    *metrics.ROUTINES,
    *images.ROUTINES,
    *codecs.ROUTINES,
    *projection.ROUTINES,
    *accumulation.ROUTINES,
    *volumes.ROUTINES,
    *upsampling.ROUTINES,
    *maps.ROUTINES,
    *alignment.ROUTINES,
)


def named(routines: Sequence[Routine], names: Sequence[str]) -> tuple[Routine, ...]:
    """Return the routines whose names contain one of these words, all of them without any; in the table's order.

    Raises UsageError for a word that is in none, with the names.
    """
    for name in names:
        if not name or not any(name.lower() in routine.name.lower() for routine in routines):
            raise UsageError(f"--only {name}: no routine has that in its name: {', '.join(r.name for r in routines)}")
    chosen = [r for r in routines if not names or any(name.lower() in r.name.lower() for name in names)]
    return tuple(chosen)
