"""Time the compiled samplers against their plain twins, interleaved in one run: python tests/bench/bench_march.py.

Prints medians in milliseconds, the ratio, and candidates a second, on a synthetic street with a carved grid.
"""

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from nerf import sample
from nerf.kernels import plain_kernels
from nerf.occupancy import Occupancy
from nerf.scene import Scene
from nerf.space import Space
from nerf.types import Rays
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


def plain(run: Callable[[], object]) -> Callable[[], object]:
    """Run with the plain twin instead of the kernels."""

    def instead() -> object:
        fastest = sample.kernels_for
        sample.kernels_for = lambda device: plain_kernels()
        try:
            return run()
        finally:
            sample.kernels_for = fastest

    return instead


def main() -> None:
    scene = corridor()
    space = Space.around(scene.T_world_cam[:, :3, 3], scene.points_m(), "ball")
    Occupancy.carve(space, scene)
    start = time.perf_counter()
    grid = Occupancy.carve(space, scene)
    print(
        f"carve {FRAMES} views of 320x96: {time.perf_counter() - start:.2f} s, {100 * grid.share:.1f} % of cells kept"
    )
    batch: Rays = scene.draw(RAYS, 0, 0)
    first = sample.march(batch, space, grid, count=64, key=(0, 0))
    weights = torch.rand(len(first.t))
    runs = {
        "march 64, grid": (64, lambda: sample.march(batch, space, grid, count=64, key=(0, 0))),
        "march 256, grid": (256, lambda: sample.march(batch, space, grid, count=256, key=(0, 0))),
        "march 64, no grid": (64, lambda: sample.march(batch, space, count=64, key=(0, 0))),
        "guided 32": (32, lambda: sample.guided(batch, space, grid, count=32, key=(0, 0))),
        "resample 32 of 64": (32, lambda: sample.resample(batch, space, first, weights, count=32, key=(0, 0))),
    }
    print(f"{RAYS} rays, {torch.get_num_threads()} threads; ms compiled, ms plain, ratio, M candidates/s, samples/ray")
    for name, (candidates, run) in runs.items():
        used = run().used
        fast, slow = median_ms(run, plain(run))
        rate = RAYS * candidates / fast / 1e3
        print(f"{name:20s} {fast:7.2f} {slow:8.2f} {slow / fast:6.1f}x {rate:8.1f} {used / RAYS:7.1f}")
    sigma = torch.rand(len(first.t))
    fast, _ = median_ms(lambda: grid.observe(first, sigma), lambda: None)
    print(f"observe {first.used} samples: {fast:.2f} ms")
    draw, _ = median_ms(lambda: scene.draw(RAYS, 0, 0), lambda: None)
    print(f"(draw {RAYS} rays: {draw:.2f} ms)")


if __name__ == "__main__":
    main()
