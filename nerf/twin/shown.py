"""What a frame shows, in plain torch: Gaussians before the sky, in the frame's own colours; and the way back.

A pixel that lets a share p of its light pass shows c = rgb + p sky(direction), the sky where p is more than `clear`,
and in the frame's colours A c + b. The sky is the sigmoid of what its pictures sum up to (nerf/twin/sky.py).
"""

import torch
from torch import Tensor

from nerf.gaussians.types import Behind, Rasterised, Shown, ShownGradients
from nerf.twin.sky import look, paint


def show(seen: Rasterised, behind: Behind) -> Shown:
    """Return what a frame shows of what was rasterised."""
    passes = (1 - seen.opacity).flatten()
    flat = torch.nonzero(passes > behind.clear).flatten()
    units = behind.units[flat] @ behind.rotation.T
    sky = torch.sigmoid(look(behind.texels, units, behind.sizes))
    whole = seen.rgb.reshape(-1, 3).clone()
    whole[flat] += passes[flat, None] * sky
    whole = whole.view_as(seen.rgb)
    rgb = whole if behind.change is None else changed(whole, behind.change)
    return Shown(rgb, behind, (flat, units, sky, whole))


def unshow(seen: Rasterised, shown: Shown, d_rgb: Tensor) -> ShownGradients:
    """Return a loss's derivatives from those (h, w, 3) by what is shown."""
    behind, (flat, units, sky, whole) = shown.behind, shown.kept
    d_change = None
    if behind.change is not None:
        each = d_rgb.reshape(-1, 3)
        d_change = torch.cat([each.T @ whole.reshape(-1, 3), each.sum(0)[:, None]], dim=1)
        d_rgb = unchanged(d_rgb, behind.change)
    d_seen, passes = d_rgb.reshape(-1, 3)[flat], (1 - seen.opacity).flatten()[flat]
    d_texels = torch.zeros_like(behind.texels)
    paint(d_seen * passes[:, None] * sky * (1 - sky), units, behind.sizes, d_texels)
    d_opacity = torch.zeros_like(seen.opacity).flatten()
    d_opacity[flat] = -(d_seen * sky).sum(1)
    return ShownGradients(d_rgb, d_opacity.view_as(seen.opacity), d_texels, d_change)


def changed(rgb: Tensor, change: Tensor) -> Tensor:
    """Return colours (h, w, 3) after a change (3, 4), A - 1 and b."""
    return rgb + rgb @ change[:, :3].T + change[:, 3]


def unchanged(d_shown: Tensor, change: Tensor) -> Tensor:
    """Return the derivative (h, w, 3) by colours before a change (3, 4), from that by those after it."""
    return d_shown + d_shown @ change[:, :3]
