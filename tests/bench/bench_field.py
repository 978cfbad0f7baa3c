"""Samples per second of the field, forward + backward + update: our kernels and the plain-PyTorch twin, in turns.

    python tests/bench/bench_field.py [--samples 65536] [--rounds 5] [--width 64] [--json FILE]
    ROADPRIOR_CPU=avx2 python tests/bench/bench_field.py

Medians and best of rounds that alternate in one process, then the best time of each part and its share of a limit
that is measured beside it: for the networks a large product of matrices, of bfloat16 where this CPU mode multiplies
them, else of float32.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from nerf.field import Field, FieldConfig
from nerf.harmonics import harmonics
from nerf.mlp import MLPConfig
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.twin import encode as twin_encode
from nerf.twin import field as twin_field
from nerf.types import GridConfig, Samples
from priors.machine import cpu, threads

PER_RAY = 32


def ray_samples(count: int) -> tuple[Samples, Tensor]:
    """Return samples in order along rays through the unit cube, and the rays' directions."""
    generator = torch.Generator().manual_seed(0)
    rays = count // PER_RAY
    start = 0.45 + 0.1 * torch.rand(rays, 1, 3, generator=generator)
    units = torch.nn.functional.normalize(torch.randn(rays, 3, generator=generator), dim=-1)
    t = torch.sort(0.45 * torch.rand(rays, PER_RAY, 1, generator=generator), dim=1).values
    u = (start + t * units[:, None]).clamp(0, 1).reshape(-1, 3)
    flat = torch.zeros(count)
    ray = torch.arange(count, dtype=torch.int32) // PER_RAY
    offsets = torch.arange(rays + 1) * PER_RAY
    return Samples(offsets, ray, flat, flat, flat, flat, u, torch.zeros(count, dtype=torch.int32), count), units


def stopwatch(function: Callable[[], object]) -> float:
    """Return the seconds that a call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def best(function: Callable[[], object], rounds: int = 30) -> float:
    """Return the shortest of several calls' seconds."""
    return min(stopwatch(function) for _ in range(rounds))


def main() -> None:
    """Run the benchmark."""
    cpu.hold_down()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=65536)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    args = parser.parse_args()
    samples, units = ray_samples(args.samples)
    generator = torch.Generator().manual_seed(1)
    d_sigma, d_rgb = torch.randn(args.samples, generator=generator), torch.randn(args.samples, 3, generator=generator)
    config = FieldConfig(mlp=MLPConfig(width=args.width))

    field = Field(config)
    optimiser = Optimiser(field.parameters(), field.copies())

    def ours() -> None:
        field.forward(samples, units)
        field.backward(d_sigma, d_rgb)
        optimiser.step(OptimiserConfig(), 0.5)

    twin = Field(config)
    leaves = {name: tensor.requires_grad_() for name, tensor in twin.parameters().items()}
    adam = torch.optim.Adam(list(leaves.values()), lr=1e-2, eps=1e-15)

    def plain() -> None:
        features = twin_encode.encode(samples.u, samples.table, None, leaves["grid"], config.grid)
        layers = twin_field.Layers(*(tensor for name, tensor in leaves.items() if name != "grid"))
        outputs = twin_field.shade(features, harmonics(units), samples.ray, layers, config.mlp.initial_density)
        adam.zero_grad()
        torch.autograd.backward(outputs, (d_sigma, d_rgb))
        adam.step()

    quietly = threads.quiet()(ours)  # as `fit` has it
    quietly(), plain()  # compile, warm up
    times: dict[str, list[float]] = {"ours": [], "plain": []}
    for _ in range(args.rounds):
        times["plain"].append(stopwatch(plain))
        times["ours"] += [stopwatch(quietly) for _ in range(5)]
    print(f"CPU mode {cpu.mode()}, {threads.count()} threads, {args.samples} samples, width {args.width}")
    for name, seconds in times.items():
        middle, quick = (args.samples / x / 1e6 for x in (statistics.median(seconds), min(seconds)))
        print(f"{name:6} {middle:8.3f} M samples/s median, {quick:8.3f} best")
    for name, pick in (("medians", statistics.median), ("best", min)):
        print(f"ratio of {name}: {pick(times['plain']) / pick(times['ours']):.1f}")
    with threads.quiet():
        shares = parts(field, optimiser, samples, units, d_sigma, d_rgb)
    if args.json:
        ours_s, plain_s = (statistics.median(times[name]) for name in ("ours", "plain"))
        figures = {"mode": cpu.mode(), "samples_s": args.samples / ours_s, "ratio": plain_s / ours_s, **shares}
        args.json.write_text(json.dumps(figures))


def product_flops() -> float:
    """Return the FLOP/s of a large product of matrices on all threads, in the type that this CPU mode multiplies."""
    if cpu.mode() in ("amx", "avx512_bf16"):
        halves = torch.zeros(2048, 2048, dtype=torch.bfloat16)
        with threads.limited(threads.count()):
            return 2 * 2048**3 / best(lambda: halves @ halves)
    matrix = np.zeros((2048, 2048), np.float32)
    with threadpool_limits(threads.count()):  # numpy's OpenBLAS follows the mode; PyTorch's MKL does not on AMD
        return 2 * 2048**3 / best(lambda: matrix @ matrix, 10)


def parts(
    field: Field, optimiser: Optimiser, samples: Samples, units: Tensor, d_sigma: Tensor, d_rgb: Tensor
) -> dict[str, float]:
    """Print what each part takes and its share of a limit measured on this machine; return the networks' share."""
    grid, network, basis, count = field.grid, field.mlp, harmonics(units), len(samples.u)
    near = Field(FieldConfig(GridConfig(log2_size=8))).grid
    features = grid.encode(samples.u, samples.table)
    d_features = network.shade_backward(features, basis, samples.ray, d_sigma, d_rgb)
    big, big_copy = torch.zeros(24 << 20), torch.zeros(24 << 20)
    bandwidth = 2 * big.nbytes / best(lambda: big_copy.copy_(big))
    flops = product_flops()
    layers = count * 2 * sum(layer.numel() for layer in network.layers)
    traffic = 30 * sum(tensor.numel() for tensor in field.parameters().values())
    close = "of the same with 2^8 rows a level"
    peak, stream = f"of {flops / 1e9:.0f} GFLOP/s, a large product", f"of {bandwidth / 1e9:.0f} GB/s, a copy of 100 MB"
    shade = (features, basis, samples.ray)
    rows: list[tuple[str, Callable[[], object], float, str]] = [
        (
            "lookup",
            lambda: grid.encode(samples.u, samples.table),
            best(lambda: near.encode(samples.u, samples.table)),
            close,
        ),
        (
            "lookup, back",
            lambda: grid.backward(samples.u, samples.table, None, d_features),
            best(lambda: near.backward(samples.u, samples.table, None, d_features)),
            close,
        ),
        ("networks", lambda: network.shade(*shade), layers / flops, peak),
        ("networks, back", lambda: network.shade_backward(*shade, d_sigma, d_rgb), 3 * layers / flops, peak),
        ("Adam", lambda: optimiser.step(OptimiserConfig(), 0.5), traffic / bandwidth, stream),
    ]
    total, found = 0.0, {}
    for name, function, limit, what in rows:
        seconds = best(function)
        total += seconds
        found[name] = limit / seconds
        share = f"{limit / seconds:4.0%} {what}"
        print(f"{name:15} {seconds * 1e3:6.2f} ms, {seconds / count * 1e9:5.1f} ns a sample: {share}")
    corners = 8 * field.config.grid.levels
    print(f"sum            {total * 1e3:7.2f} ms: {count / total / 1e6:.2f} M samples/s")
    print(f"a sample: {corners} corners, {corners * 4} bytes read, {corners * 16} read and written back,")
    print(f"          {4 * layers / count / 1e3:.1f} kFLOP with the forward pass that the backward one repeats")
    return {"peak_flops": flops, "networks": found["networks"], "networks_back": found["networks, back"]}


if __name__ == "__main__":
    main()
