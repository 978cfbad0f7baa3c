"""`priors stress`: every numerical routine at the limits of its numbers, and networks on extreme images."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cli.arguments import parse
from cli.console import DATA_ERROR, out, progress
from cli.stress import StressArguments, stress
from priors.errors import UsageError
from priors.export.networks import parse_size
from priors.stress.inputs import INPUTS
from priors.stress.routine import Routine

if TYPE_CHECKING:
    from priors.stress.network import Tried

EXAMPLES = """Run every numerical routine on extreme inputs (0, denormals, 65504, 1e30, inf, NaN, one pixel, ...) in
each precision, and compare values and gradients with float64. One line a routine; exits 1 where a cell fails.

examples:
  priors stress
  priors stress --only volume argmin
  priors stress --json                                   every cell, and why some make no sense
  priors stress --modes --markdown docs/numerics.md      in each CPU mode; the page's tables are made anew
  ROADPRIOR_CPU=avx2 priors stress                       as on a CPU that has no more than AVX2
  priors stress --network mine.onnx                      a network of yours on black, white, noise, one pixel, ...
"""
USUAL_SIZE = (128, 416)
"""(height, width) of the images that a network is shown."""


@dataclass(frozen=True)
class PriorsStressArguments(StressArguments):
    """Arguments of `priors stress`."""

    network: tuple[Path, ...] = ()
    """Put these networks through extreme images instead: .onnx or .safetensors files, as in `priors bench`."""
    image_size: str | None = None
    """With --network: WIDTHxHEIGHT of the images, pixels; default: 416x128."""

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_size(self.image_size)
        if self.image_size is not None and not self.network:
            raise UsageError("--image-size: read with --network: add it, or leave --image-size out")
        idle = [name for name in ("only", "modes", "markdown") if getattr(self, name)]
        if self.network and idle:
            raise UsageError(f"--{idle[0]}: of the routines: leave out --{idle[0]} or --network")

    def routines(self) -> Sequence[Routine]:
        """Return the rows: metrics, codecs, projection, volumes, ..."""
        from priors.stress.routines import ROUTINES

        return ROUTINES


ARGUMENTS = {"priors stress": PriorsStressArguments}


def run(arguments: list[str]) -> int:
    """Make the table; returns the exit code."""
    args = parse(PriorsStressArguments, "priors stress", EXAMPLES, arguments)
    return _networks(args) if args.network else stress(args, "priors", INPUTS, arguments)


def _networks(args: PriorsStressArguments) -> int:
    """Try the networks and print what came of it; returns the exit code: 1 where a map is not as stated."""
    from priors.bench.entrants import network
    from priors.stress import network as networks

    size = parse_size(args.image_size) or USUAL_SIZE
    entrants = [network(file) for file in args.network]
    found = {}
    with args.limited(), progress("inputs", len(entrants) * len(networks.INPUTS)) as step:
        for entrant in entrants:
            found[entrant.name] = networks.try_network(entrant.method, size, step)
    if args.json:
        out.write(
            json.dumps({name: [each.record() for each in tried] for name, tried in found.items()}, indent=1) + "\n"
        )
    else:
        out.write(_told(found))
    return DATA_ERROR if any(each.fault for tried in found.values() for each in tried) else 0


def _told(found: "Mapping[str, Sequence[Tried]]") -> str:
    """Write a line an input under each network's name."""
    lines = []
    for name, tried in found.items():
        lines.append(name)
        for each in tried:
            depths = f"{each.nearest_m:.3g} to {each.farthest_m:.3g} m" if each.nearest_m is not None else "no depth"
            what = each.fault or (
                f"refused: {each.told}" if each.told else f"{depths}, {each.density:.0%} of the image"
            )
            lines.append(f"  {each.input:<20}{'FAILS  ' if each.fault else 'ok     '}{what}")
    faults = sum(bool(each.fault) for tried in found.values() for each in tried)
    return "\n".join([*lines, "", f"{sum(map(len, found.values()))} inputs, {faults} not as stated"]) + "\n"
