"""The shipped table: what every method took on one machine, for drives that nobody has measured.

    python tests/bench/bench_shipped.py --write        measures it: shipped.json

Its times are processor time of one thread, and are scaled three times. By how far stereo must search: along a line
through two frames (searched.py). From two sizes of image to a third: by a power law through both. From that machine to
this one: by the probes (probe.py), of the same kind of CPU. Errors are of
procedural streets: they rank, and a drive of yours has others.
"""

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from priors.bench.probe import Kind
from priors.machine.cpu import Mode

FILE = Path(__file__).with_name("shipped.json")
NETWORKS = ("cfnet", "pcwnet", "bts", "mffnet", "mono")
"""Words in an entrant's name that tell that convolutions take most of its time."""


@cache
def table() -> dict[str, Any]:
    """Return what was measured, by mode of CPU: for two sizes the pixels, and the times of entrants and probes."""
    measured: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return measured


def modes_like(mode: Mode) -> list[Mode]:
    """Return the measured modes, the most like a machine's own first: more of a CPU's abilities, then fewer."""
    order: list[Mode] = ["amx", "avx512_bf16", "avx512", "avx2", "plain"]
    place = order.index(mode) if mode in order else 0
    return sorted((each for each in order if each in table()["modes"]), key=lambda each: abs(order.index(each) - place))


def times_ms(
    mode: Mode, pixels: int, probes_ms: Mapping[Kind, float], searched: float | None = None
) -> dict[str, float]:
    """Predict what a frame takes here by each entrant, ms.

    Args:
        mode: of this machine's CPU.
        pixels: of an image.
        probes_ms: what `calibrate` measured here.
        searched: the largest disparity as a share of the image's width; None: that of the table's frame.
    """
    full, half = table()["modes"][modes_like(mode)[0]]
    return {
        name: _at(pixels, (full["pixels"], _ms(full, name, searched)), (half["pixels"], _ms(half, name, searched)))
        * _slower(name, probes_ms, full["probes_ms"])
        for name in full["ms"]
        if name in half["ms"]
    }


def errors() -> dict[str, dict[str, float]]:
    """Return each entrant's AbsRel, density and density_image on procedural streets."""
    found: dict[str, dict[str, float]] = table()["errors"]
    return found


def _ms(at: Mapping[str, Any], name: str, searched: float | None) -> float:
    """Interpolate an entrant's time at one size between a frame of few disparities and one of many."""
    near, far = at["searched"]
    ms = float(at["ms"][name])
    if searched is None or name not in at["ms_far"]:
        return ms
    slope = (at["ms_far"][name] - ms) / (far - near)
    return max(0.5 * ms, ms + slope * (searched - near))


def _at(pixels: int, full: tuple[int, float], half: tuple[int, float]) -> float:
    """Interpolate a time at another size, by a power law through two."""
    power = math.log(full[1] / half[1]) / math.log(full[0] / half[0])
    return float(full[1] * (pixels / full[0]) ** power)


def _slower(name: str, here: Mapping[Kind, float], there: Mapping[Kind, float]) -> float:
    """Return how much slower this machine is at an entrant's kind of work: the geometric mean of its probes' ratios."""
    kinds: tuple[Kind, ...] = ("matching", "kernels")
    if any(word in name for word in NETWORKS):
        kinds = ("convolutions", "matching") if "stereo" in name else ("convolutions", "kernels")
    return math.exp(sum(math.log(here[kind] / there[kind]) for kind in kinds) / len(kinds))
