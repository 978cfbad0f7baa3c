"""Gaussian splatting on GPUs: tensors to the Triton kernels and back.

    project, shade    a record of each Gaussian, and the box of its pixels
    enlist            a key of each tile that it reaches: tile and depth, sorted by torch
    draw              tiles of 16 x 16 pixels: blended near to far
    undraw            tiles: sums over the pixels, added to each Gaussian's
    unproject         from the sums to the parameters

A view waits for the device twice: for how many Gaussians are in view, and for how many tiles they reach.
"""

import math
from typing import Any, NamedTuple

import numpy as np
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
from nerf.kernels.lens import lens_of
from nerf.kernels.triton import splat_blend, splat_pixels, splat_project, splat_unblend, splat_unproject
from nerf.kernels.triton.splat_project import RECORD_NUMBERS, TILE_PX
from nerf.kernels.triton.splat_train import adam as adam
from nerf.kernels.triton.splat_train import colour_loss as colour_loss
from nerf.kernels.triton.splat_unblend import SUM_NUMBERS
from nerf.twin.shown import show as show
from nerf.twin.shown import unshow as unshow

_BLOCK = 128
"""Gaussians that a program projects."""
_ENTRIES = 512
"""Keys that a program writes."""
_ROWS, _COUNT, _WARPS = 16, 4, 4
"""Rows of a tile, Gaussians at a time, and warps of a program that draws ..."""
_ROWS_BACK, _COUNT_BACK = 8, 4
"""... and on the way back, where a program is one warp: sums over pixels then need no barrier."""
_PARTS = 32
"""Gaussians of a single pixel at a time."""


class Shown(NamedTuple):
    """What is in view."""

    records: Tensor
    """(v, RECORD_NUMBERS) splat_project.py says what stands where."""
    members: Tensor
    """(entries,) int32 the Gaussians of all tiles, near first: places among those in view."""
    starts: Tensor
    """(tiles + 1,) int64 where each tile's begin."""


class Kept(NamedTuple):
    """What the way back needs."""

    gaussians: Gaussians
    lens: Tensor
    drawing: Drawing
    size: tuple[int, int]
    shown: Shown
    rgb: Tensor
    """Before a black background."""
    background: Tensor | None


def rasterise(
    gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, background: Tensor | None = None
) -> Rasterised:
    """Draw Gaussians near to far."""
    gaussians = Gaussians(*(_checked(x) for x in gaussians.tensors().values()))
    lens, size = _lens(viewpoint, drawing, gaussians.means_m.device), viewpoint.camera.size
    index, records, boxes, tiles = _project(gaussians, lens, size, drawing)
    shown = _listed(records, boxes, tiles, size)
    like = gaussians.opacities
    rgb, (depth_sum, opacity) = like.new_empty(*size, 3), (like.new_empty(size) for _ in range(2))
    median_m = like.new_empty(size) if drawing.median else like.new_zeros(size)
    splat_blend.draw[_tiles(size, _ROWS)](
        *shown, *_rules(drawing, size), rgb, depth_sum, opacity, median_m, MEDIAN=drawing.median, ROWS=_ROWS,
        COUNT=_COUNT, num_warps=_WARPS,
    )  # fmt: skip
    radii_px = 0.5 * (boxes[:, 1::2] - boxes[:, ::2]).amax(1).float()
    kept = Kept(gaussians, lens, drawing, size, shown, rgb, background)
    if background is not None:
        rgb = rgb + (1 - opacity)[..., None] * background
    return Rasterised(rgb, depth_sum, opacity, median_m, index, radii_px, kept)


def backward(rasterised: Rasterised, gradients: ViewGradients) -> SplatGradients:
    """Return a loss's derivatives by the Gaussians in view; float32 additions in no fixed order."""
    kept: Kept = rasterised.kept
    nothing = torch.zeros_like(rasterised.opacity)
    d_depth, d_opacity = (nothing if x is None else x for x in (gradients.depth_sum, gradients.opacity))
    if kept.background is not None:
        d_opacity = d_opacity - (gradients.rgb * kept.background).sum(2)
    sums = nothing.new_zeros(len(kept.shown.records), SUM_NUMBERS)
    drawn = kept.rgb, rasterised.depth_sum, rasterised.opacity
    given = (x.contiguous() for x in (gradients.rgb, d_depth, d_opacity))
    splat_unblend.undraw[_tiles(kept.size, _ROWS_BACK)](
        *kept.shown, *_rules(kept.drawing, kept.size), *drawn, *given, sums, ROWS=_ROWS_BACK, COUNT=_COUNT_BACK,
        num_warps=1,
    )  # fmt: skip
    if gradients.contributions is not None:
        _add_parts(kept, gradients.contributions, gradients, sums)
    return _unproject(kept, rasterised.index, sums)


def contributions(rasterised: Rasterised, pixels: Tensor) -> Contributions:
    """Return what pixels (r,) are made of; waits for the device."""
    kept: Kept = rasterised.kept
    where, r = pixels.to(torch.int64).contiguous(), len(pixels)
    least_log, enough, width, _, across = _rules(kept.drawing, kept.size)
    inputs = *kept.shown, least_log, enough, width, across, where
    counts = where.new_empty(r)
    empty = where.new_empty(0, dtype=torch.int32), *(kept.rgb.new_empty(0) for _ in range(3))
    splat_pixels.walk[r,](*inputs, counts, counts, *empty, FILL=False, COUNT=_PARTS, num_warps=1)
    offsets = _starts(counts)
    m = int(offsets[-1])
    which, parts = where.new_empty(m, dtype=torch.int32), [kept.rgb.new_empty(m) for _ in range(3)]
    splat_pixels.walk[r,](*inputs, offsets, counts, which, *parts, FILL=True, COUNT=_PARTS, num_warps=1)
    return Contributions(pixels, offsets, rasterised.index[which.long()], parts[0], parts[1], parts[2], which)


def _project(
    gaussians: Gaussians, lens: Tensor, size: tuple[int, int], drawing: Drawing
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return which Gaussians are in view, (v,), their records, boxes (v, 4) int32, and how many tiles each reaches."""
    means_m, log_scales, rotations, opacities, harmonics = gaussians.tensors().values()
    n = len(means_m)
    every = means_m.new_empty(n, RECORD_NUMBERS)
    boxes, tiles = (torch.empty(n, *more, dtype=torch.int32, device=means_m.device) for more in ((4,), ()))
    splat_project.project[-(-n // _BLOCK),](
        means_m, log_scales, rotations, opacities, lens, size[1], size[0], n, every, boxes, tiles,
        COMPENSATE=drawing.compensate, BLOCK=_BLOCK,
    )  # fmt: skip
    index = torch.nonzero(tiles)[:, 0]
    records, v = every[index], len(index)
    splat_project.shade[-(-v // _BLOCK),](
        index, means_m, harmonics, lens, v, harmonics.shape[1], records, USED=_used(gaussians, drawing), BLOCK=_BLOCK
    )
    return index, records, boxes[index], tiles[index]


def _listed(records: Tensor, boxes: Tensor, tiles: Tensor, size: tuple[int, int]) -> Shown:
    """List the tiles' Gaussians, near first; those of one depth in their order."""
    first = _starts(tiles)
    total = int(first[-1])
    owners = torch.arange(len(tiles), dtype=torch.int32, device=tiles.device)
    owners = torch.repeat_interleave(owners, tiles, output_size=total)
    keys = torch.empty(total, dtype=torch.int64, device=tiles.device)
    down, across = (-(-side // TILE_PX) for side in size)
    splat_project.enlist[-(-total // _ENTRIES),](owners, first, records, boxes, across, total, keys, BLOCK=_ENTRIES)
    keys, order = torch.sort(keys, stable=True)
    edges = torch.arange(down * across + 1, device=tiles.device) << 32
    return Shown(records, owners[order], torch.searchsorted(keys, edges))


def _add_parts(kept: Kept, made: Contributions, gradients: ViewGradients, sums: Tensor) -> None:
    """Add to the sums what derivatives by single pixels' parts say."""
    nothing = torch.zeros_like(made.weights)
    given = (nothing if x is None else x.contiguous() for x in (gradients.weights, gradients.tau))
    where = made.pixels.to(torch.int64).contiguous()
    parts = made.kept, made.alphas, made.weights
    splat_pixels.back[len(where),](
        kept.shown.records, where, kept.size[1], made.offsets, *parts, *given, sums, COUNT=_PARTS, num_warps=1
    )


def _unproject(kept: Kept, index: Tensor, sums: Tensor) -> SplatGradients:
    """Return the derivatives by the parameters from the Gaussians' sums (v, SUM_NUMBERS)."""
    v, used, harmonics = len(index), _used(kept.gaussians, kept.drawing), kept.gaussians.harmonics
    of = Gaussians(*(sums.new_empty(shape) for shape in ((v, 3), (v, 3), (v, 4), (v,), (v, used, 3))))
    programs = -(-v // _BLOCK)
    screen, twists = sums.new_empty(v), sums.new_empty(programs, 6)
    splat_unproject.unproject[programs,](
        index, *kept.gaussians.tensors().values(), kept.lens, v, harmonics.shape[1], kept.shown.records, sums,
        *of.tensors().values(), screen, twists, COMPENSATE=kept.drawing.compensate, USED=used, BLOCK=_BLOCK,
    )  # fmt: skip
    return SplatGradients(index, of, screen, twists.sum(0, dtype=torch.float64).float())


def _lens(viewpoint: Viewpoint, drawing: Drawing, device: torch.device) -> Tensor:
    """Return a camera as the kernels read it: splat_shape.py says what stands where."""
    lens = lens_of(viewpoint, drawing)
    numbers: list[Any] = [np.atleast_1d(np.asarray(x, np.float32)) for x in lens[:12]]
    return torch.from_numpy(np.concatenate(numbers)).to(device)


def _rules(drawing: Drawing, size: tuple[int, int]) -> tuple[float, float, int, int, int]:
    """Return the least alpha's logarithm, base 2, when a pixel is finished, the width, the height, tiles in a row."""
    return math.log2(drawing.least_alpha), drawing.enough, size[1], size[0], -(-size[1] // TILE_PX)


def _tiles(size: tuple[int, int], rows: int) -> tuple[int, int]:
    """Return the programs of an image: its tiles, and the parts of each that have so many rows."""
    down, across = (-(-side // TILE_PX) for side in size)
    return down * across, TILE_PX // rows


def _used(gaussians: Gaussians, drawing: Drawing) -> int:
    """Return how many harmonics of each Gaussian count."""
    return min(SIZES[drawing.degree], gaussians.harmonics.shape[1])


def _starts(counts: Tensor) -> Tensor:
    """Return where each of these many begins, and where the last ends, int64."""
    ends = counts.cumsum(0, dtype=torch.int64)
    return torch.cat([ends.new_zeros(1), ends])


def _checked(tensor: Tensor) -> Tensor:
    if tensor.dtype != torch.float32:  # kernels would read other numbers
        raise ValueError(f"expected float32, found {tensor.dtype}")
    return tensor.detach().contiguous()
