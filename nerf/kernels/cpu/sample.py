"""Samplers on the CPU: tensors to the compiled loops and back; rays are tasks of the pool."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels.plain import sample as plain
from nerf.types import Course, Samples, padded_count
from priors.machine import threads


def pick(course: Course, kept: Tensor | None, resolution: int) -> Samples:
    """Return the candidates whose middle lies in a kept cell (flat uint8 grid; None: all), padded.

    The loops are bit for bit the twin's in float32 and know no other precision: there the twin itself answers.
    """
    if course.start.dtype != torch.float32:
        return plain.pick(course, kept, resolution)
    from nerf.kernels.cpu.march import choose, fill

    count, rows = len(course.start), (
        course.norms, course.knee_m, course.low, course.span, course.start,
        course.stop, course.band0_m, course.band1_m, course.shift,
    )  # fmt: skip
    along = torch.stack(rows).numpy()
    origins, directions, counts = (x.contiguous().numpy() for x in (course.origins, course.directions, course.count))
    ends = np.empty((2, count, 0), np.float32) if course.ends is None else course.ends.numpy()
    grid = np.empty(0, np.uint8) if kept is None else kept.numpy()
    near, far = np.float32(course.near_m), np.float32(course.far_m)
    chosen, found = np.empty((count, course.slots), np.uint8), np.empty(count, np.int64)
    given = (origins, directions, along, counts, course.band_count)
    asked = (*given, course.slots, ends, near, far, course.kind, grid, resolution, chosen, found)
    threads.over(count, lambda first, last: choose(*asked, first, last))
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(found)])
    used = int(offsets[-1])
    m = padded_count(used)
    ray, table, u = np.empty(m, np.int32), np.empty(m, np.int32), np.empty((3, m), np.float32)
    t, dt_m, s0, s1 = (np.empty(m, np.float32) for _ in range(4))
    packed = (ray, t, dt_m, s0, s1, u, table)
    wanted = (*given, ends, near, far, course.kind, chosen, offsets, *packed)
    threads.over(count, lambda first, last: fill(*wanted, first, last))
    for array in packed:
        array[..., used:] = -1 if array is ray else 0
    tensor = torch.from_numpy
    return Samples(
        tensor(offsets), tensor(ray), tensor(t), tensor(dt_m), tensor(s0), tensor(s1), tensor(u).T, tensor(table), used
    )


def resample(samples: Samples, weights: Tensor, targets: Tensor, margin: float, anneal: float) -> Tensor:
    """Return the ends (2, r, n) in s of n intervals of even mass under the weights (m,)."""
    from nerf.kernels.cpu.resample import invert

    rays, count = targets.shape[0], targets.shape[1] - 1
    ends = np.empty((2, rays, count), np.float32)
    histogram = samples.offsets, samples.s0[: samples.used], samples.s1[: samples.used], weights[: samples.used]
    given = (*(x.contiguous().numpy() for x in histogram), targets.numpy(), margin, anneal, ends)
    threads.over(rays, lambda first, last: invert(*given, first, last))
    return torch.from_numpy(ends)


def trace(segments: tuple[npt.NDArray[Any], ...], kind: int, resolution: int, grid: npt.NDArray[np.uint8]) -> None:
    """Set the cells (flat uint8 grid) that rays pass: carving, before the first step, on arrays.

    segments: origins and directions (r, 3) in the space, first and last depth (r,), metres; all float32.
    """
    from nerf.kernels.cpu.march import trace as loop

    threads.over(len(segments[0]), lambda first, last: loop(*segments, kind, resolution, grid, first, last))
