"""Gaussian splatting on devices without kernels of their own: the twin and its autograd, blocks of pixels at a time."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from nerf.gaussians.types import (
    NAMES,
    SIZES,
    ColourLoss,
    Contributions,
    Drawing,
    Gaussians,
    Rasterised,
    Rates,
    SplatGradients,
    SplatMoments,
    ViewGradients,
    Viewpoint,
)
from nerf.twin import adam as twin_adam
from nerf.twin import colour_loss as twin_loss
from nerf.twin import splat as twin
from nerf.twin.shown import show as show
from nerf.twin.shown import unshow as unshow
from nerf.twin.splat import Projected

BLOCK = 16
"""Pixels along a side of a block."""


class Kept(NamedTuple):
    """What the way back needs."""

    gaussians: Gaussians
    viewpoint: Viewpoint
    drawing: Drawing
    background: Tensor | None


def rasterise(
    gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, background: Tensor | None = None
) -> Rasterised:
    """Draw Gaussians near to far."""
    size = viewpoint.camera.size
    projected = twin.project(gaussians, viewpoint, drawing)
    index = torch.nonzero(twin.in_view(projected, size))[:, 0]
    projected = projected.rows(index)
    like = projected.z_m
    rgb, depth_sum, opacity, middle = like.new_zeros(*size, 3), *(like.new_zeros(*size) for _ in range(3))
    for rows, columns, pixels, near in _blocks(projected, size):
        some = projected.rows(near)
        blended = twin.blend(some, pixels, drawing)
        shape = rows.stop - rows.start, columns.stop - columns.start
        colour, moment, stopped = twin.sums(some, blended, drawing)
        rgb[rows, columns] = colour.reshape(*shape, 3)
        depth_sum[rows, columns], opacity[rows, columns] = moment.reshape(shape), stopped.reshape(shape)
        if drawing.median:
            middle[rows, columns] = twin.median(some, blended).reshape(shape)
    if background is not None:
        rgb += (1 - opacity)[..., None] * background
    low, high = twin.boxes(projected, size)
    radii_px = 0.5 * (high - low).amax(1)
    kept = Kept(gaussians, viewpoint, drawing, background)
    return Rasterised(rgb, depth_sum, opacity, middle, index, radii_px, kept)


def contributions(rasterised: Rasterised, pixels: Tensor) -> Contributions:
    """Return what pixels (r,) are made of."""
    gaussians, viewpoint, drawing, _ = rasterised.kept
    projected = twin.project(gaussians, viewpoint, drawing)
    order = rasterised.index[_near_first(projected.z_m[rasterised.index])]
    projected = projected.rows(order)
    blended = twin.blend(projected, _places(pixels, viewpoint.camera.size, projected.z_m), drawing)
    there = blended.alphas > 0
    which = torch.nonzero(there)[:, 1]
    offsets = torch.cat([pixels.new_zeros(1), there.sum(1).cumsum(0)])
    packed = blended.alphas[there], blended.weights[there], projected.z_m[which]
    return Contributions(pixels, offsets, order[which], *packed)


def backward(rasterised: Rasterised, gradients: ViewGradients) -> SplatGradients:
    """Return a loss's derivatives by the Gaussians in view."""
    gaussians, viewpoint, drawing, _ = rasterised.kept
    with torch.enable_grad():
        leaves = Gaussians(*(x.detach()[rasterised.index].requires_grad_() for x in gaussians.tensors().values()))
        twist = leaves.means_m.new_zeros(6).requires_grad_()
        projected = twin.project(leaves, viewpoint, drawing, twist)
        d_projected = _by_projected(rasterised, Projected(*(x.detach() for x in projected)), gradients)
        inputs = [*leaves.tensors().values(), twist]
        found = torch.autograd.grad(projected[:5], inputs, d_projected, allow_unused=True)
    *of, harmonics, d_twist = (torch.zeros_like(x) if d is None else d for x, d in zip(inputs, found, strict=True))
    used = min(SIZES[drawing.degree], leaves.harmonics.shape[1])
    own = Gaussians(of[0], of[1], of[2], of[3], harmonics[:, :used].contiguous())
    return SplatGradients(rasterised.index, own, torch.linalg.vector_norm(d_projected[0], dim=1), d_twist)


def _by_projected(rasterised: Rasterised, projected: Projected, gradients: ViewGradients) -> list[Tensor]:
    """Return the derivatives by what was projected of the Gaussians in view: the first five of Projected."""
    drawing, background = rasterised.kept.drawing, rasterised.kept.background
    size = rasterised.opacity.shape
    d_opacity = torch.zeros_like(rasterised.opacity) if gradients.opacity is None else gradients.opacity
    d_depth = torch.zeros_like(rasterised.opacity) if gradients.depth_sum is None else gradients.depth_sum
    if background is not None:
        d_opacity = d_opacity - (gradients.rgb * background).sum(2)
    inputs = [x.requires_grad_() for x in projected[:5]]
    d_projected = [torch.zeros_like(x) for x in inputs]

    def add(outputs: Sequence[Tensor], d_outputs: Sequence[Tensor]) -> None:
        for total, found in zip(
            d_projected, torch.autograd.grad(outputs, inputs, d_outputs, allow_unused=True), strict=True
        ):
            if found is not None:
                total += found

    for rows, columns, pixels, near in _blocks(projected, (size[0], size[1])):
        if not len(near):
            continue
        some = projected.rows(near)
        outputs = twin.sums(some, twin.blend(some, pixels, drawing), drawing)
        asked = gradients.rgb[rows, columns].reshape(-1, 3), d_depth[rows, columns].flatten()
        add(outputs, [*asked, d_opacity[rows, columns].flatten()])
    made = gradients.contributions
    if made is not None and len(made.gaussian):
        order = _near_first(projected.z_m.detach())
        blended = twin.blend(projected.rows(order), _places(made.pixels, (size[0], size[1]), projected.z_m), drawing)
        there = blended.alphas.detach() > 0
        d_made = [torch.zeros_like(made.weights) if d is None else d for d in (gradients.weights, gradients.tau)]
        add([blended.weights[there], -torch.log1p(-blended.alphas[there])], d_made)
    return d_projected


def adam(gaussians: Gaussians, gradients: SplatGradients, moments: SplatMoments, rates: Rates, step: int) -> None:
    """Do the step-th step of Adam for the Gaussians in view."""
    index = gradients.index
    for name in NAMES:
        d = getattr(gradients.of, name)
        whole = [getattr(x, name) for x in (gaussians, moments.mean, moments.square)]
        if name == "harmonics":
            whole = [x[:, : d.shape[1]] for x in whole]
        parameter, mean, square = (x[index] for x in whole)
        before = parameter.clone()
        parameter.grad = d.to(parameter)
        twin_adam.adam(parameter, mean, square, 1.0, step)
        moved = before + (parameter - before) * _rate(name, rates, moments.unit_m[index], d.shape[1:])
        if name == "rotations":
            length = torch.linalg.vector_norm(moved, dim=1, keepdim=True)
            moved = torch.where(length > 0, moved / length.clamp(min=1e-20), moved)
        for target, value in zip(whole, (moved, mean, square), strict=True):
            target[index] = value


def _rate(name: str, rates: Rates, unit_m: Tensor, shape: torch.Size) -> Tensor:
    if name == "harmonics":
        return unit_m.new_tensor([rates.colours] + [rates.view] * (shape[0] - 1))[:, None]
    rate = getattr(rates, "means" if name == "means_m" else name)
    return rate * unit_m[:, None] if name == "means_m" else unit_m.new_tensor(rate)


def colour_loss(rgb: Tensor, truth: Tensor, share: float, weight: Tensor | None = None) -> ColourLoss:
    """Return L1 and SSIM of pictures, and the derivative."""
    with torch.enable_grad():
        asked = rgb.detach().requires_grad_()
        absolute, dissimilarity = twin_loss.parts(asked, truth, share, weight)
        total = (1 - share) * absolute + share * dissimilarity
        (d_rgb,) = torch.autograd.grad(total, asked)
    return ColourLoss(float(absolute.detach()), float(dissimilarity.detach()), float(total.detach()), d_rgb)


def _blocks(projected: Projected, size: tuple[int, int]) -> Iterator[tuple[slice, slice, Tensor, Tensor]]:
    """Give blocks of the image: rows, columns, their pixels (p, 2), and the Gaussians that reach them, near first."""
    low, high = (x.detach() for x in twin.boxes(projected, size))
    order = _near_first(projected.z_m.detach())
    for top in range(0, size[0], BLOCK):
        rows = slice(top, min(top + BLOCK, size[0]))
        band = order[(low[order, 1] < rows.stop) & (high[order, 1] >= rows.start)]
        for left in range(0, size[1], BLOCK):
            columns = slice(left, min(left + BLOCK, size[1]))
            near = band[(low[band, 0] < columns.stop) & (high[band, 0] >= columns.start)]
            y, x = (torch.arange(s.start, s.stop, device=low.device) for s in (rows, columns))
            pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), -1).reshape(-1, 2).to(low)
            yield rows, columns, pixels, near


def _near_first(z_m: Tensor) -> Tensor:
    """Return the order of depth; equal ones as they lie."""
    return torch.sort(z_m, stable=True).indices


def _places(pixels: Tensor, size: tuple[int, int], like: Tensor) -> Tensor:
    """Return x and y (r, 2) of pixels row * width + column."""
    return torch.stack([pixels % size[1], pixels // size[1]], 1).to(like)
