"""Samplers on the CPU: tensors to the compiled loops and back; rays are tasks of the pool."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels.plain import sample as plain
from nerf.types import Course, Extent, Histogram, Samples, padded_count
from priors.machine import threads

PRUNED = 1 << 18
"""Cells of a task that prunes; the mean is added up part by part, so that threads change nothing."""


def pick(course: Course, kept: Tensor | None, resolution: int) -> Samples:
    """Return the candidates whose middle lies in a kept cell (flat uint8 grid; None: all), padded.

    The loops are bit for bit the twin's in float32 and know no other precision: there the twin itself answers.
    """
    if course.start.dtype != torch.float32:
        return plain.pick(course, kept, resolution)
    from nerf.kernels.cpu.march import Cells, Packed, choose, fill

    paths, count = _paths(course), len(course.start)
    cells = Cells(np.empty(0, np.uint8) if kept is None else kept.numpy(), resolution)
    chosen, counts = np.empty((count, course.slots), np.uint8), np.empty(count, np.int64)
    threads.over(count, lambda first, last: choose(paths, cells, chosen, counts, first, last))
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])
    used = int(offsets[-1])
    m = padded_count(used)
    ray, table, u = np.empty(m, np.int32), np.empty(m, np.int32), np.empty((3, m), np.float32)
    t, dt_m, s0, s1 = (np.empty(m, np.float32) for _ in range(4))
    packed = Packed(ray, t, dt_m, s0, s1, u, table)
    threads.over(count, lambda first, last: fill(paths, chosen, offsets, packed, first, last))
    for array in packed:
        array[..., used:] = -1 if array is ray else 0
    tensor = torch.from_numpy
    along = tensor(t), tensor(dt_m), tensor(s0), tensor(s1)
    return Samples(tensor(offsets), tensor(ray), *along, u=tensor(u).T, table=tensor(table), used=used)


def _paths(course: Course) -> Any:
    """Bring a course to the loops' form."""
    from nerf.kernels.cpu.march import Paths

    def array(x: Tensor) -> Any:
        return x.contiguous().numpy()

    spacing = course.spacing
    return Paths(
        origins=array(course.origins),
        directions=array(course.directions),
        norm=array(course.norms),
        knee=array(spacing.knee_m),
        low=array(spacing.low),
        span=array(spacing.span),
        start=array(course.start),
        stop=array(course.stop),
        band0=array(course.band0_m),
        band1=array(course.band1_m),
        shift=array(course.shift),
        candidates=array(course.count),
        band_count=course.band_count,
        ends=np.empty((2, len(course.start), 0), np.float32) if course.ends is None else array(course.ends),
        near=np.float32(spacing.near_m),
        far=np.float32(spacing.far_m),
        kind=course.kind,
    )


def resample(histogram: Histogram, targets: Tensor) -> Tensor:
    """Return the ends (2, r, n) in s of n intervals of even mass under a histogram."""
    from nerf.kernels.cpu.resample import invert

    samples, rays, count = histogram.samples, targets.shape[0], targets.shape[1] - 1
    ends = np.empty((2, rays, count), np.float32)
    packed = (x[: samples.used].contiguous().numpy() for x in (samples.s0, samples.s1, histogram.weights))
    read = (samples.offsets.numpy(), *packed, targets.numpy(), histogram.margin, histogram.anneal)
    threads.over(rays, lambda first, last: invert(*read, ends, first, last))
    return torch.from_numpy(ends)


def stretch(u: Tensor, table: Tensor, extent: Extent) -> Tensor:
    """Return the metres (n,) that one unit of u spans at u (n, 3)."""
    if u.dtype != torch.float32:
        return plain.stretch(u, table, extent)
    from nerf.kernels.cpu.occupancy import stretch as loop

    out, places, tables = np.empty(len(u), np.float32), u.T.contiguous().numpy(), table.contiguous().numpy()
    numbers = _extent(extent)
    threads.over(len(u), lambda first, last: loop(places, tables, numbers, out, first, last))
    return torch.from_numpy(out)


def note(thickness: Tensor, u: Tensor, table: Tensor, sigma: Tensor, extent: Extent, decay: float) -> None:
    """Note densities in an occupancy grid; one task: cells are shared."""
    from nerf.kernels.cpu.occupancy import note as loop

    arrays = (x.contiguous().numpy() for x in (u.T, table, sigma))
    loop(thickness.view(-1).numpy(), *arrays, thickness.shape[-1], _extent(extent), np.float32(decay))


def prune(thickness: Tensor, allowed: Tensor, thin: float, kept: Tensor) -> None:
    """Decide which cells of an occupancy grid are kept."""
    from nerf.kernels.cpu.occupancy import prune as loop
    from nerf.kernels.cpu.occupancy import total

    cells = thickness.view(-1).numpy()
    parts = [(first, min(first + PRUNED, cells.size)) for first in range(0, cells.size, PRUNED)]
    sums = np.zeros((len(parts), 2))
    threads.run(len(parts), lambda part: total(cells, sums[part], *parts[part]))
    found, count = sums.sum(axis=0)
    limit = np.float32(min(thin, found / count) if count else thin)
    flat, out = allowed.view(-1).numpy(), kept.view(-1).numpy()
    threads.run(len(parts), lambda part: loop(cells, flat, limit, out, *parts[part]))


def _extent(extent: Extent) -> tuple[int, np.float32, np.float32, np.float32, np.float32]:
    """Return the kind, the metres that u spans inside and (at |place| = 1) outside, 1 / the farthest place, air_m."""
    inner, outer, nearest = 2 * extent.mean_m, 4 * extent.mean_m, 1 / extent.farthest
    return extent.kind, np.float32(inner), np.float32(outer), np.float32(nearest), np.float32(extent.air_m)


def trace(segments: tuple[npt.NDArray[Any], ...], kind: int, resolution: int, grid: npt.NDArray[np.uint8]) -> None:
    """Set the cells (flat uint8 grid) that rays pass: carving, before the first step, on arrays.

    segments: origins and directions (r, 3) in the space, first and last depth (r,), metres; all float32.
    """
    from nerf.kernels.cpu.march import trace as loop

    threads.over(len(segments[0]), lambda first, last: loop(*segments, kind, resolution, grid, first, last))
