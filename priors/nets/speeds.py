"""Which runtime is fastest on which kind of CPU: a table that tests/bench/bench_runtimes.py measures and writes.

    python tests/bench/bench_runtimes.py --write

Nothing is measured at run time. A kind of CPU that nobody measured gets what its name promises: bf16 where it has
instructions for that, else fp32.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any, Literal

from priors.machine.cpu import Mode

FILE = Path(__file__).with_name("speeds.json")
FAST_BF16: tuple[Mode, ...] = ("amx", "avx512_bf16")
"""Modes that make bf16 the fast path where nothing was measured."""

GRAPH_MUST_GAIN = 1.1
"""onnxruntime is taken where it is faster by this: its graph takes seconds to make, for each size of image."""

OnCpu = Literal["bf16", "fp32", "int8", "onnx"]


@cache
def table() -> dict[str, Any]:
    """Return what was measured: machine, and for each mode and network the time of each runtime, in SGBM's times."""
    measured: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return measured


def fastest(mode: Mode, net: str | None, *, integers: bool = False) -> OnCpu:
    """Return what runs a network fastest on CPUs of a mode; `integers`: int8 can run it."""
    here = _measured(mode, net, integers)
    if not here:
        return "bf16" if mode in FAST_BF16 else "fp32"
    best: OnCpu = min(here, key=lambda runtime: here[runtime] * (GRAPH_MUST_GAIN if runtime == "onnx" else 1))
    return best


def times(mode: Mode, net: str, *, integers: bool = False) -> float | None:
    """Return how many times SGBM's time a network takes, run as `fastest` says; None where nobody measured it."""
    return _measured(mode, net, integers).get(fastest(mode, net, integers=integers))


def _measured(mode: Mode, net: str | None, integers: bool) -> dict[OnCpu, float]:
    """Return the time of each runtime that can run a network, in SGBM's times."""
    ratios = table()["modes"].get(mode, {}).get("ratios", {}).get(net, {})
    there = {"bf16": True, "fp32": True, "int8": integers, "onnx": True}
    return {runtime: float(ratio) for runtime, ratio in ratios.items() if there[runtime]}
