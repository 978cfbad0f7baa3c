"""tests/bench/bench_gpu.py at both settings of docs/gpu.md."""

from argparse import Namespace

import torch

from nerf.field import FieldConfig
from nerf.mlp import MLPConfig
from nerf.types import GridConfig
from tests.bench.bench_gpu import measure
from tests.bench.gpu.parts import note

SETTINGS = ((19, 64), (17, 16))
"""log2 of the rows of a level, neurons."""


def run(options: Namespace) -> None:
    """Note the figures of each setting as they come; on a CPU small shapes, which say nothing about a GPU."""
    device, small = torch.device(options.device), options.device == "cpu"
    count, rounds, repeats = (1 << 13, 1, 1) if small else (1 << 18, 5, 20)
    if small:
        note(left_out=f"2^18 samples and the CUDA graph: {count} samples on the CPU's kernels")
    for log2_size, width in SETTINGS:
        config = FieldConfig(GridConfig(log2_size=14 if small else log2_size), MLPConfig(width=width))
        name = f"2^{config.grid.log2_size} rows, {width} neurons"
        found: dict[str, float] = {}
        for figures in measure(device, count, config, rounds, repeats):
            found |= {key: float(f"{value:.4g}") for key, value in figures.items()}
            note(**{name: found})
