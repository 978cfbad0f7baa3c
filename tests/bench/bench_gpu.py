"""Samples a second of the hash field, forward + backward + update, on a GPU: kernels, the plain twin, and the parts.

python tests/bench/bench_gpu.py [--samples 262144] [--log2-size 19] [--width 64]
"""

import argparse
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerf.field import Field, FieldConfig
from nerf.harmonics import harmonics
from nerf.kernels import Kernels, kernels_for, plain_kernels
from nerf.mlp import MLPConfig
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.types import Gradients, GridConfig, Samples

RAY_SAMPLES = 32


@dataclass(frozen=True)
class Step:
    """One training step of a field on fixed rays, without sampler and losses; called, it runs."""

    field: Field
    optimiser: Optimiser
    samples: Samples
    units: Tensor
    sky: Tensor
    kernels: Kernels

    def __call__(self) -> None:
        sigma, rgb = self.field.forward(self.samples, self.units)
        rendered = self.kernels.render.forward(self.samples, sigma, rgb, self.sky)
        gradients = Gradients.zeros(rendered)
        gradients.rgb.copy_(rendered.rgb - 0.5)
        d_sigma, d_rgb, _ = self.kernels.render.backward(self.samples, sigma, rgb, self.sky, rendered, gradients)
        self.field.backward(d_sigma, d_rgb)
        self.optimiser.step(OptimiserConfig(), 0.5)


def prepare(device: torch.device, count: int, config: FieldConfig, kernels: Kernels) -> Step:
    """Make rays with RAY_SAMPLES samples each through the unit cube, and a field that runs on these kernels."""
    rays = count // RAY_SAMPLES
    made = torch.Generator().manual_seed(0)
    units = torch.nn.functional.normalize(torch.randn(rays, 3, generator=made), dim=1)
    shares = (torch.arange(RAY_SAMPLES) + torch.rand(rays, RAY_SAMPLES, generator=made)) / RAY_SAMPLES
    places = (torch.rand(rays, 1, 3, generator=made) + 0.4 * shares[..., None] * units[:, None]).clamp(0, 1)
    zeros = torch.zeros(count, device=device)
    samples = Samples(
        offsets=torch.arange(0, count + 1, RAY_SAMPLES, device=device),
        ray=torch.arange(rays, dtype=torch.int32, device=device).repeat_interleave(RAY_SAMPLES),
        t=(1 + 20 * shares).flatten().to(device),
        dt_m=zeros + 20 / RAY_SAMPLES,
        s0=shares.flatten().to(device),
        s1=shares.flatten().to(device) + 1 / RAY_SAMPLES,
        u=places.flatten(0, 1).T.contiguous().to(device).T,
        table=torch.zeros(count, dtype=torch.int32, device=device),
        used=count,
    )
    field = Field(config, device, kernels=kernels.field)
    optimiser = Optimiser(field.parameters(), field.copies(), kernels.field)
    return Step(field, optimiser, samples, units.to(device), torch.full((rays, 3), 0.5, device=device), kernels)


def parts(step: Step) -> dict[str, Callable[[], Any]]:
    """Return the stages of a step, each to be called alone."""
    field, samples = step.field, step.samples
    fast, painter = step.kernels.field, step.kernels.render
    grid, layers, config = field.grid, field.mlp.layers, field.config.grid
    weights = grid.weights.to(fast.STORAGE)
    basis = harmonics(step.units)
    features = fast.encode(samples.u, samples.table, None, weights, config)
    sigma, rgb = fast.shade(features, basis, samples.ray, layers, 0.02)
    made = painter.forward(samples, sigma, rgb, step.sky)
    gradients, spread = Gradients.zeros(made), torch.zeros_like(grid.weights)
    gradients.rgb.fill_(1)
    return {
        "encode": lambda: fast.encode(samples.u, samples.table, None, weights, config),
        "shade": lambda: fast.shade(features, basis, samples.ray, layers, 0.02),
        "render": lambda: painter.forward(samples, sigma, rgb, step.sky),
        "render backward": lambda: painter.backward(samples, sigma, rgb, step.sky, made, gradients),
        "shade backward": lambda: fast.shade_backward(features, basis, samples.ray, layers, 0.02, sigma, rgb),
        "spread": lambda: fast.spread(samples.u, samples.table, None, features, config, spread),
        "update": lambda: step.optimiser.step(OptimiserConfig(), 0.5),
    }


def milliseconds(run: Callable[[], Any], device: torch.device, repeats: int) -> float:
    """Time a call, once warm: the mean of `repeats` calls in a row."""
    run()
    wait(device)
    start = time.perf_counter()
    for _ in range(repeats):
        run()
    wait(device)
    return 1e3 * (time.perf_counter() - start) / repeats


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def captured(step: Step) -> Callable[[], None]:
    """Record a step as a CUDA graph (the learning rate stays what it was when recorded)."""
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        for _ in range(3):
            step()
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def measure(
    device: torch.device, count: int, config: FieldConfig, rounds: int, repeats: int
) -> Iterator[dict[str, float]]:
    """Time a step of `count` samples; yields figures as soon as they are known: kernels and twin, parts, graph.

    The twin takes as many samples: with fewer, what a call costs whatever its size would count too much.
    The graph comes last: where recording it fails, the GPU may refuse everything after it.
    """
    fast = prepare(device, count, config, kernels_for(device))
    slow = prepare(device, count, config, plain_kernels())
    times = []
    for _ in range(rounds):
        one = milliseconds(fast, device, repeats)
        other = milliseconds(slow, device, 1)
        times.append((one, other))
    one, other = np.median(times, axis=0)
    yield {
        "step ms": one,
        "M samples/s": count / one / 1e3,
        "twin M samples/s": count / other / 1e3,
        "ratio": float(np.median([b / a for a, b in times])),
    }
    for part, run in parts(fast).items():
        yield {f"{part} ms": milliseconds(run, device, repeats)}
    if device.type == "cuda":
        yield {"MiB": torch.cuda.max_memory_allocated(device) / 2**20}
        replay = milliseconds(captured(fast), device, repeats)
        yield {"graph ms": replay, "graph M samples/s": count / replay / 1e3}


def main() -> None:
    """Print million samples a second, the ratio to the twin, and where the time goes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 18)
    parser.add_argument("--log2-size", type=int, default=19)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args()
    device, count = torch.device(options.device), options.samples // 2048 * 2048
    config = FieldConfig(GridConfig(log2_size=options.log2_size), MLPConfig(width=options.width))
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else f"CPU {platform.machine()}"
    print(f"{name}; torch {torch.__version__}; {count} samples, {config.grid.rows} rows, {options.width} neurons")
    print(f"{kernels_for(device).field.__name__}; forward + backward + update; the twin does the same samples")
    for figures in measure(device, count, config, options.rounds, options.repeats):
        for key, value in figures.items():
            print(f"  {key:20}{value:10.3f}", flush=True)


if __name__ == "__main__":
    main()
