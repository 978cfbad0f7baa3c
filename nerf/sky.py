"""Environment map: a colour for every direction, behind everything."""

from dataclasses import dataclass

import torch
from torch import Tensor

from priors.errors import expect


@dataclass(frozen=True, slots=True)
class SkyConfig:
    """The resolution of the sky's pictures."""

    sizes: tuple[int, ...] = (8, 32, 128)
    """Texels along a side of each: the coarse ones colour what the fine ones never saw."""

    def __post_init__(self) -> None:
        expect(bool(self.sizes) and min(self.sizes) >= 2, "sky sizes", self.sizes, "one or more, of 2 texels or more")


class Sky:
    """A sum of square pictures of the sphere, folded to an octahedron; the colour is the sum's sigmoid."""

    def __init__(self, config: SkyConfig, device: torch.device | str = "cpu") -> None:
        """Make a grey sky."""
        self.config = config
        self.texels = torch.zeros(sum(size**2 for size in config.sizes), 3, device=device)
        self.texels.grad = torch.zeros_like(self.texels)
        self._rows = self._shares = self._rgb = torch.empty(0)

    def forward(self, units: Tensor) -> Tensor:
        """Return colours (r, 3) in [0, 1] of unit directions (r, 3)."""
        self._rows, self._shares = corners(units, self.config.sizes)
        self._rgb = torch.sigmoid((self.texels[self._rows] * self._shares[:, :, None]).sum(1))
        return self._rgb

    def backward(self, d_rgb: Tensor) -> None:
        """Set the texels' gradient from that of the last `forward`'s colours, (r, 3)."""
        assert self.texels.grad is not None
        d_sum = d_rgb * self._rgb * (1 - self._rgb)
        d_texels = self._shares[:, :, None] * d_sum[:, None, :]
        self.texels.grad.zero_().index_add_(0, self._rows.flatten(), d_texels.flatten(0, 1))

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name; a backward pass sets their `.grad`."""
        return {"texels": self.texels}


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
