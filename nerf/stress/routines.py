"""All rows of `nerf stress`."""

from nerf.stress import contraction, field, gaussians, losses, rendering, sampling
from priors.stress.routine import Routine

ROUTINES: tuple[Routine, ...] = (
    *contraction.ROUTINES,
    *field.ROUTINES,
    *rendering.ROUTINES,
    *losses.ROUTINES,
    *gaussians.ROUTINES,
    *sampling.ROUTINES,
)
