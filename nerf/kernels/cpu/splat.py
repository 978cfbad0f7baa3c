"""Gaussian splatting on the CPU: tensors to the compiled loops and back, in tasks of the pool.

    project        chunks of Gaussians: a record and a box each, and how many reach each region of the image
    spread         chunks: their members into the regions' lists
    draw           regions: sorted by depth, listed by tile, blended
    undraw         regions: sums over the pixels, of each member
    unproject      chunks: from sums to parameters

Chunks and regions are cut the same however many threads there are, and sums are added in their order.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.types import (
    SIZES,
    Contributions,
    Drawing,
    Gaussians,
    Rasterised,
    SplatGradients,
    ViewGradients,
    Viewpoint,
)
from nerf.kernels.cpu import splat_blend, splat_pixels, splat_project, splat_unblend, splat_unproject
from nerf.kernels.cpu.splat_blend import Picture, Rules
from nerf.kernels.cpu.splat_pixels import Packed
from nerf.kernels.cpu.splat_project import CHUNK, RECORD, REGION, Lists, Scene, View
from nerf.kernels.cpu.splat_region import TILES, Regions, Scratch
from nerf.kernels.cpu.splat_shown import show as show
from nerf.kernels.cpu.splat_shown import unshow as unshow
from nerf.kernels.cpu.splat_train import adam as adam
from nerf.kernels.cpu.splat_train import colour_loss as colour_loss
from nerf.kernels.cpu.splat_unblend import Wanted
from nerf.kernels.cpu.splat_unproject import Derivatives
from nerf.kernels.lens import Lens, lens_of
from priors.machine import threads


class Kept(NamedTuple):
    """What the way back needs."""

    scene: Scene
    lens: Lens
    view: View
    lists: Lists
    regions: Regions
    rules: Rules
    picture: Picture
    most: int
    """Members of the largest region."""


def rasterise(
    gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, background: Tensor | None = None
) -> Rasterised:
    """Draw Gaussians near to far."""
    scene, lens = _scene(gaussians, drawing.degree), lens_of(viewpoint, drawing)
    size = viewpoint.camera.size
    view, (chunks, regions) = _project(scene, lens)
    lists, members = _spread(view, size, chunks, regions)
    entries = view.entries.reshape(chunks, regions).sum(0, dtype=np.int64)
    members = members._replace(first_entry=_starts(entries), entries=np.empty(entries.sum(), np.int32))
    rules = Rules(
        np.float32(np.log2(np.float32(drawing.least_alpha))), np.float32(drawing.enough), drawing.median, size
    )
    rgb, (depth_sum, opacity, median_m) = torch.empty(*size, 3), (torch.empty(size) for _ in range(3))
    behind = torch.zeros(3) if background is None else background
    images = (_flat(x) for x in (rgb, depth_sum, opacity, median_m, behind))
    picture = Picture(*images)
    most = int(np.diff(members.first_member).max(initial=0))
    kept = Kept(scene, lens, view, lists, members, rules, picture, most)

    def draw(first: int, last: int) -> None:
        with scratch(most) as own:
            splat_blend.draw(view, members, rules, own, picture, first, last)

    threads.over(regions, draw)
    index = torch.from_numpy(lists.gaussians)
    return Rasterised(rgb, depth_sum, opacity, median_m, index, torch.from_numpy(lists.radii_px), kept)


def backward(rasterised: Rasterised, gradients: ViewGradients) -> SplatGradients:
    """Return a loss's derivatives by the Gaussians in view."""
    kept: Kept = rasterised.kept
    scene, v = kept.scene, len(kept.lists.gaussians)
    parts = np.empty(int(kept.lists.copies[-1]) * RECORD, np.float32)
    none = np.empty(0, np.float32)
    wanted = Wanted(*(none if x is None else _flat(x) for x in (gradients.rgb, gradients.depth_sum, gradients.opacity)))

    def undraw(first: int, last: int) -> None:
        with scratch(kept.most) as own:
            splat_unblend.undraw(kept.view, kept.regions, kept.rules, own, kept.picture, wanted, parts, first, last)

    threads.over(len(kept.regions.first_member) - 1, undraw)
    made = gradients.contributions
    if made is not None:
        by = (none if x is None else _flat(x) for x in (gradients.weights, gradients.tau))
        where, width = made.pixels.to(torch.int64).contiguous().numpy(), kept.rules.size[1]
        splat_pixels.back(kept.view, where, width, made.offsets.numpy(), made.kept, *by, parts)
    shapes = (v, 3), (v, 3), (v, 4), (v,), (v, scene.used, 3)
    of, screen = Gaussians(*(torch.empty(shape) for shape in shapes)), torch.empty(v)
    chunks = len(kept.view.found)
    twists = np.empty(6 * chunks)
    flat = [_flat(x) for x in of.tensors().values()]
    out = Derivatives(flat[0], flat[1], flat[2], flat[3], flat[4], screen.numpy(), twists)
    loop = splat_unproject.unproject
    threads.over(chunks, lambda first, last: loop(scene, kept.lens, kept.view, kept.lists, parts, out, first, last))
    twist = torch.from_numpy(twists.reshape(chunks, 6).sum(0)).float()
    return SplatGradients(rasterised.index, of, screen, twist)


def contributions(rasterised: Rasterised, pixels: Tensor) -> Contributions:
    """Return what pixels (r,) are made of."""
    kept: Kept = rasterised.kept
    where = pixels.to(torch.int64).contiguous().numpy()
    arrays = kept.view, kept.regions, kept.rules, where
    found = np.empty(len(where), np.int64)
    threads.over(len(where), lambda first, last: splat_pixels.count(*arrays, found, first, last))
    offsets = _starts(found)
    m = int(offsets[-1])
    made = Packed(np.empty(m, np.int32), np.empty(m, np.int32), *(np.empty(m, np.float32) for _ in range(3)))
    if m:
        threads.over(len(where), lambda first, last: splat_pixels.fill(*arrays, offsets, made, first, last))
    gaussian = torch.from_numpy(kept.view.gaussian[made.rows].astype(np.int64))
    alphas, weights, depths_m = (torch.from_numpy(x) for x in (made.alphas, made.weights, made.depths_m))
    return Contributions(pixels, torch.from_numpy(offsets), gaussian, alphas, weights, depths_m, made)


def _scene(gaussians: Gaussians, degree: int) -> Scene:
    flat = [_flat(x) for x in gaussians.tensors().values()]
    stored = gaussians.harmonics.shape[1]
    return Scene(flat[0], flat[1], flat[2], flat[3], flat[4], stored, min(SIZES[degree], stored))


def _flat(tensor: Tensor) -> npt.NDArray[np.float32]:
    if tensor.dtype != torch.float32:  # lanes would read other numbers
        raise ValueError(f"expected float32, found {tensor.dtype}")
    return tensor.detach().contiguous().numpy().reshape(-1)


def _starts(counts: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Return where each of these many begins, and where the last ends."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(counts, dtype=np.int64)])


def _project(scene: Scene, lens: Lens) -> tuple[View, tuple[int, int]]:
    """Return what is in view, and how many chunks and regions there are."""
    chunks = max(1, -(-len(scene.opacities) // CHUNK))
    regions = -(-lens.size[0] // REGION) * -(-lens.size[1] // REGION)
    rows = chunks * CHUNK
    records, found = np.empty(rows * RECORD, np.float32), np.zeros(chunks, np.int32)
    counts = (np.zeros(chunks * regions, np.int32) for _ in range(2))
    view = View(records, np.empty(rows * 4, np.int32), np.empty(rows, np.int32), found, *counts)
    threads.over(chunks, lambda first, last: splat_project.project(scene, lens, view, first, last))
    return view, (chunks, regions)


def _spread(view: View, size: tuple[int, int], chunks: int, regions: int) -> tuple[Lists, Regions]:
    """List the regions' members, by region and there by number."""
    copies = view.copies.reshape(chunks, regions)
    by_region = _starts(copies.T.reshape(-1))
    cursor = by_region[:-1].reshape(regions, chunks).T.flatten()
    first_index, first_copy = _starts(view.found), _starts(copies.sum(1))
    v, total = int(first_index[-1]), int(first_copy[-1])
    each, members = np.empty(v + 1, np.int32), np.empty(2 * total, np.int32)
    each[v] = total
    lists = Lists(first_index, first_copy, cursor, np.empty(v, np.int64), np.empty(v, np.float32), each, members)
    loop = splat_project.spread_over_regions
    threads.over(chunks, lambda first, last: loop(view, size, lists, first, last))
    first_member = np.append(by_region[:-1:chunks], total)
    nothing = np.empty(0, np.int32), np.empty(0, np.int64)
    return lists, Regions(members, first_member, *nothing, np.empty(regions * (TILES + 1), np.int32))


_spare: list[tuple[int, Scratch]] = []


@contextmanager
def scratch(most: int) -> Iterator[Scratch]:
    """Lend room for a region of so many members: what a thread had before, where that is enough."""
    try:
        room, own = _spare.pop()
    except IndexError:
        room, own = -1, None
    if own is None or room < most:
        room = most + most // 4
        numbers = (np.empty(room * RECORD, np.float32) for _ in range(2))
        keys, order = np.empty(2 * room, np.uint32), np.empty(2 * room, np.int32)
        masks = np.empty(room, np.uint64)
        own = Scratch(next(numbers), keys, order, masks, next(numbers), np.empty(1024, np.float32))
    try:
        yield own
    finally:
        _spare.append((room, own))
