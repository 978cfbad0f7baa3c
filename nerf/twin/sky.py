"""Environment map in plain torch: a sum of square pictures of the sphere, folded to an octahedron."""

import torch
from torch import Tensor


def corners(units: Tensor, sizes: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Return the rows (r, 4 n) and shares (r, 4 n) of the texels that a direction (r, 3) lies between in n pictures.

    Octahedral map (Praun and Hoppe 2003): project to |x| + |y| + |z| = 1, unfold the half z < 0 over the corners.
    """
    flat = units / units.abs().sum(-1, keepdim=True)
    x, y = flat[:, 0], flat[:, 1]
    sign_x, sign_y = torch.where(x < 0, -1.0, 1.0), torch.where(y < 0, -1.0, 1.0)
    below = flat[:, 2] < 0
    u = torch.where(below, (1 - y.abs()) * sign_x, x)
    v = torch.where(below, (1 - x.abs()) * sign_y, y)
    place = torch.stack([u, v], dim=-1) * 0.5 + 0.5
    rows, shares, start = [], [], 0
    for size in sizes:
        texel = place * (size - 1)
        low = texel.floor().clamp(0, size - 2)
        within = texel - low
        for right in (0, 1):
            for down in (0, 1):
                share_x = within[:, 0] if right else 1 - within[:, 0]
                share_y = within[:, 1] if down else 1 - within[:, 1]
                rows.append(start + (low[:, 1].long() + down) * size + low[:, 0].long() + right)
                shares.append(share_x * share_y)
        start += size**2
    return torch.stack(rows, dim=1), torch.stack(shares, dim=1)


def look(texels: Tensor, units: Tensor, sizes: tuple[int, ...]) -> Tensor:
    """Return what the pictures (texels, 3) sum up to in unit directions (r, 3): (r, 3)."""
    rows, shares = corners(units, sizes)
    return (texels[rows] * shares[:, :, None]).sum(1)


def paint(d_sums: Tensor, units: Tensor, sizes: tuple[int, ...], d_texels: Tensor) -> None:
    """Set the texels' gradient (texels, 3) from that of the sums, (r, 3)."""
    rows, shares = corners(units, sizes)
    d_each = shares[:, :, None] * d_sums[:, None, :]
    d_texels.zero_().index_add_(0, rows.flatten(), d_each.flatten(0, 1))
