"""Time the compiled samplers against their plain twins, interleaved in one run: python tests/bench/bench_march.py.

Prints medians in milliseconds, the ratio, and candidates a second, on a synthetic street with a carved grid.
"""

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from nerf.kernels import Kernels, cpu_kernels, plain_kernels
from nerf.occupancy import Occupancy
from nerf.sample import Sampler, SamplerConfig
from nerf.scene import Scene
from nerf.space import Space
from nerf.types import Histogram, Rays, Samples
from priors.geometry import rays as pixel_rays
from priors.types import Camera

CAMERA = Camera(np.array([[186.0, 0, 160], [0, 186.0, 46], [0, 0, 1]]), (96, 320))
FRAMES, RAYS, REPEATS = 20, 1024, 30


def corridor() -> Scene:
    """A road 1.7 m below, walls 8 m to the sides, an end 80 m ahead; noise of 5 %."""
    rays = pixel_rays(CAMERA)
    with np.errstate(divide="ignore"):
        surfaces = [1.7 / np.maximum(rays[..., 1], 0), 8 / np.abs(rays[..., 0])]
    noise = 1 + 0.05 * np.random.default_rng(0).normal(size=(FRAMES, *CAMERA.size))
    depth_m = np.minimum.reduce([*surfaces, np.full(CAMERA.size, 80.0)]) * noise
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 2, 3] = np.arange(FRAMES)
    images = np.zeros((FRAMES, *CAMERA.size, 3), np.uint8)
    frames = list(range(FRAMES))
    return Scene("corridor", [], CAMERA, poses, images, depth_m.astype(np.float32), None, frames, [])


def median_ms(run: Callable[[], object], other: Callable[[], object]) -> tuple[float, float]:
    """Time two functions in turns."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(REPEATS):
        for function, series in zip((run, other), times, strict=True):
            start = time.perf_counter()
            function()
            series.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[0]), statistics.median(times[1])


def main() -> None:
    scene = corridor()
    space = Space.along(scene.T_world_cam, "ball")
    Occupancy.carve(space, scene)
    start = time.perf_counter()
    grid = Occupancy.carve(space, scene)
    print(
        f"carve {FRAMES} views of 320x96: {time.perf_counter() - start:.2f} s, {100 * grid.share:.1f} % of cells kept"
    )
    batch: Rays = scene.draw(RAYS, 0, 0)
    key = (0, 0)
    first = Sampler(space, grid).march(batch, 64, key)
    histogram = Histogram(first, torch.rand(len(first.t)))

    def runs(kernels: Kernels) -> dict[str, tuple[int, Callable[[], Samples]]]:
        sampler, blind = Sampler(space, grid, kernels.sample), Sampler(space, None, kernels.sample)
        return {
            "march 64, grid": (64, lambda: sampler.march(batch, 64, key)),
            "march 256, grid": (256, lambda: sampler.march(batch, 256, key)),
            "march 64, no grid": (64, lambda: blind.march(batch, 64, key)),
            "guided 32": (32, lambda: sampler.guided(batch, SamplerConfig(count=32), key)),
            "resample 32 of 64": (32, lambda: blind.resample(batch, histogram, 32, key)),
        }

    print(f"{RAYS} rays, {torch.get_num_threads()} threads; ms compiled, ms plain, ratio, M candidates/s, samples/ray")
    slow_runs = runs(plain_kernels())
    for name, (candidates, run) in runs(cpu_kernels()).items():
        used = run().used
        fast, slow = median_ms(run, slow_runs[name][1])
        rate = RAYS * candidates / fast / 1e3
        print(f"{name:20s} {fast:7.2f} {slow:8.2f} {slow / fast:6.1f}x {rate:8.1f} {used / RAYS:7.1f}")
    sigma = torch.rand(len(first.t))
    fast, _ = median_ms(lambda: grid.observe(first, sigma), lambda: None)
    print(f"observe {first.used} samples: {fast:.2f} ms")
    draw, _ = median_ms(lambda: scene.draw(RAYS, 0, 0), lambda: None)
    print(f"(draw {RAYS} rays: {draw:.2f} ms)")


if __name__ == "__main__":
    main()
