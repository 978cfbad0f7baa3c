"""Samplers in plain torch: every candidate interval of every ray side by side, then the kept ones packed.

What the kernels must equal bit for bit in float32; runs on any device.
"""

import torch
from torch import Tensor

from nerf.twin.space import depth, spacing, warp
from nerf.types import Course, Histogram, Samples, Spacing


def cells(u: Tensor, table: Tensor, resolution: int) -> Tensor:
    """Return the flat index (n,) int64 of the grid cell that holds u (n, 3) of table (n,)."""
    x, y, z = torch.clamp((u * resolution).to(torch.int64), max=resolution - 1).unbind(-1)
    return ((table.to(torch.int64) * resolution + z) * resolution + y) * resolution + x


def pick(course: Course, kept: Tensor | None, resolution: int) -> Samples:
    """Return the candidates whose middle lies in a kept cell (flat uint8 grid; None: all), without padding."""
    s0, s1, t0, t1 = _edges(course)
    t = (t0 + t1) * 0.5
    place = course.origins[:, None] + t[..., None] * course.directions[:, None]
    u, table = warp(place, course.kind)
    chosen = t1 > t0
    if kept is not None:
        chosen &= kept[cells(u, table, resolution)] > 0
    counts = chosen.sum(dim=1)
    offsets = torch.cat([counts.new_zeros(1), torch.cumsum(counts, 0)])
    ray = torch.nonzero(chosen)[:, 0].to(torch.int32)
    dt_m = (t1 - t0) * course.norms[:, None]
    t, dt_m, s0, s1, u, table = (x[chosen] for x in (t, dt_m, s0, s1, u, table))
    return Samples(offsets, ray, t, dt_m, s0, s1, u, table, len(ray))


def _edges(course: Course) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return s and depth of each candidate's two ends, (r, slots); empty ones have equal ends."""
    slot = torch.arange(course.slots, device=course.start.device)[None]
    knee_m, low, span, near_m, far_m = course.spacing
    ramps = Spacing(knee_m[:, None], low[:, None], span[:, None], near_m, far_m)
    if course.ends is not None:
        s0, s1 = course.ends
        return s0, s1, depth(s0, ramps), depth(s1, ramps)
    count, shift = course.count[:, None], course.shift[:, None]
    start, length = course.start[:, None], (course.stop - course.start)[:, None]
    share0, share1 = _shares(slot, shift, count)
    s0, s1 = start + share0 * length, start + share1 * length
    t0, t1 = depth(s0, ramps), depth(s1, ramps)
    # The band follows the stretch's count + 1 candidates.
    step = slot - count - 1
    begin, width = course.band0_m[:, None], (course.band1_m - course.band0_m)[:, None]
    share0, share1 = _shares(torch.clamp(step, min=0), shift, torch.full_like(count, course.band_count))
    b0, b1 = begin + share0 * width, begin + share1 * width
    in_band = (step >= 0) & (step <= course.band_count) & (width > 0)
    in_stretch = (step < 0) & (length > 0)
    t0, t1 = torch.where(in_band, b0, t0), torch.where(in_band, b1, t1)
    s0, s1 = torch.where(in_band, spacing(b0, ramps), s0), torch.where(in_band, spacing(b1, ramps), s1)
    return s0, s1, t0, torch.where(in_band | in_stretch, t1, t0)


def _shares(index: Tensor, shift: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
    """Return where candidate `index` of `count` begins and ends, [0, 1]."""
    whole = count.to(shift.dtype)
    begin, end = (index - 1).to(shift.dtype) + shift, index.to(shift.dtype) + shift
    return torch.clamp(begin / whole, 0, 1), torch.clamp(end / whole, 0, 1)


def resample(histogram: Histogram, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Return the ends (r, n), float32, of n intervals of even mass under each ray's histogram; computed in float64.

    The histogram's bins [s0, s1] (packed, ascending, gaps allowed) are widened by its margin, where bins overlap the
    larger density counts, and the masses between their edges are raised to `anneal` (MipNeRF-360, appendix C).
    `targets` (r, n + 1) are the ends' places in the cumulated mass. No interval reaches across a gap: it stays within
    the connected bins that hold its middle. A ray without mass is sampled evenly in its bins; one without bins gets
    empty intervals.
    """
    targets, offsets = targets.double(), histogram.samples.offsets
    edges, mass, gap = _widened(histogram)
    width = edges.diff(dim=1) * ~gap
    mass = torch.where(mass > 0, torch.clamp(mass, min=1e-30) ** histogram.anneal, 0.0)
    mass = torch.where(mass.sum(dim=1, keepdim=True) > 0, mass, width)
    cumulated = torch.cumsum(torch.cat([torch.zeros_like(mass[:, :1]), mass], 1), 1)
    cumulated = cumulated / torch.clamp(cumulated[:, -1:], min=1e-30)
    ends = _invert(cumulated, edges, targets)[0]
    middle = _invert(cumulated, edges, (targets[:, 1:] + targets[:, :-1]) * 0.5)[1]
    index = torch.arange(gap.shape[1], device=gap.device).expand_as(gap)
    first = torch.cummax(torch.where(gap, index, -1), 1)[0] + 1
    last = torch.cummin(torch.where(gap, index, gap.shape[1]).flip(1), 1)[0].flip(1)
    begin = torch.maximum(ends[:, :-1], edges.gather(1, first.gather(1, middle)))
    end = torch.minimum(ends[:, 1:], edges.gather(1, last.gather(1, middle)))
    some = (offsets[1:] > offsets[:-1])[:, None]
    return (begin * some).float(), (torch.maximum(begin, end) * some).float()


def _widened(histogram: Histogram) -> tuple[Tensor, Tensor, Tensor]:
    """Widen the bins: edges (r, 2b), and of the spaces between them mass and whether no bin covers them (r, 2b - 1)."""
    samples, margin = histogram.samples, histogram.margin
    packed = (samples.s0, samples.s1, histogram.weights)
    offsets, (s0, s1, weights) = samples.offsets, (x[: max(samples.used, 1)].double() for x in packed)
    counts = offsets[1:] - offsets[:-1]
    most = max(int(counts.max()) if len(counts) else 0, 1)
    step = torch.arange(most, device=s0.device)
    real = step < counts[:, None]
    index = torch.clamp(offsets[:-1, None] + step, max=max(len(s0) - 1, 0))
    begin, end = torch.where(real, s0[index], 1.0), torch.where(real, s1[index], 1.0)
    density = torch.where(real & (end > begin), weights[index] / torch.clamp(end - begin, min=1e-30), 0.0)
    low = torch.where(real, torch.clamp(begin - margin, min=0), 1.0)
    high = torch.clamp(end + margin, max=1)
    edges = torch.cat([low, high], 1).sort(dim=1)[0]
    middle = (edges[:, 1:] + edges[:, :-1]) * 0.5
    covers = (middle[..., None] >= low[:, None]) & (middle[..., None] <= high[:, None]) & real[:, None]
    highest = torch.where(covers, density[:, None], 0.0).amax(-1)
    return edges, highest * edges.diff(dim=1), ~covers.any(-1)


def _invert(cumulated: Tensor, edges: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Return where the cumulated mass reaches the targets, and in which space."""
    after_target = torch.searchsorted(cumulated, targets.contiguous(), right=True)
    space = torch.clamp(after_target - 1, 0, cumulated.shape[1] - 2)
    before, after = cumulated.gather(1, space), cumulated.gather(1, space + 1)
    share = torch.clamp((targets - before) / torch.clamp(after - before, min=1e-30), 0, 1)
    begin, end = edges.gather(1, space), edges.gather(1, space + 1)
    return begin + share * (end - begin), space
