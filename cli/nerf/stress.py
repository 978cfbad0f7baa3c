"""`nerf stress`: the numerical routines of fields at the limits of their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

from cli.arguments import parse
from cli.stress import StressArguments, stress
from priors.stress.routine import Routine

EXAMPLES = """Run every numerical routine of fields (contraction, encoding, networks, compositing, losses, samples,
Adam) on extreme inputs, and compare values and gradients with float64. One line a routine; exits 1 where a cell fails.

examples:
  nerf stress
  nerf stress --only loss distortion
  nerf stress --json                                     every cell, and why some make no sense
  nerf stress --modes --markdown docs/numerics.md        in each CPU mode; the page's tables are made anew
  ROADPRIOR_CPU=plain nerf stress                        as on any CPU
"""


@dataclass(frozen=True)
class NerfStressArguments(StressArguments):
    """Arguments of `nerf stress`."""

    def routines(self) -> Sequence[Routine]:
        """Return the rows: contraction, encoding, networks, losses, ..."""
        from nerf.stress.routines import ROUTINES

        return ROUTINES


ARGUMENTS = {"nerf stress": NerfStressArguments}


def run(arguments: list[str]) -> int:
    """Make the table; returns the exit code."""
    from nerf.stress.inputs import INPUTS

    args = parse(NerfStressArguments, "nerf stress", EXAMPLES, arguments)
    return stress(args, "nerf", INPUTS, arguments)
