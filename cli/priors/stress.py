"""`priors stress`: every numerical routine at the limits of its numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

from cli.arguments import parse
from cli.stress import StressArguments, stress
from priors.stress.inputs import INPUTS
from priors.stress.routine import Routine

EXAMPLES = """Run every numerical routine on extreme inputs (0, denormals, 65504, 1e30, inf, NaN, one pixel, ...) in
each precision, and compare values and gradients with float64. One line a routine; exits 1 where a cell fails.

examples:
  priors stress
  priors stress --only volume argmin
  priors stress --json                                   every cell, and why some make no sense
  priors stress --modes --markdown docs/numerics.md      in each CPU mode; the page's tables are made anew
  ROADPRIOR_CPU=avx2 priors stress                       as on a CPU that has no more than AVX2
"""


@dataclass(frozen=True)
class PriorsStressArguments(StressArguments):
    """Arguments of `priors stress`."""

    def routines(self) -> Sequence[Routine]:
        """Return the rows: metrics, codecs, projection, volumes, ..."""
        from priors.stress.routines import ROUTINES

        return ROUTINES


ARGUMENTS = {"priors stress": PriorsStressArguments}


def run(arguments: list[str]) -> int:
    """Make the table; returns the exit code."""
    args = parse(PriorsStressArguments, "priors stress", EXAMPLES, arguments)
    return stress(args, "priors", INPUTS, arguments)
