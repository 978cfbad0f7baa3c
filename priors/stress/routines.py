"""All rows of `priors stress`."""

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
