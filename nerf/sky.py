"""Environment map: a colour for every direction, behind everything."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.kernels import RenderKernels, kernels_for
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

    def __init__(
        self, config: SkyConfig, device: torch.device | str = "cpu", kernels: RenderKernels | None = None
    ) -> None:
        """Make a grey sky; `kernels`: other functions than the device's own fastest."""
        self.config = config
        self.texels = torch.zeros(sum(size**2 for size in config.sizes), 3, device=device)
        self.texels.grad = torch.zeros_like(self.texels)
        self._units = self._rgb = torch.empty(0)
        self._kernels = kernels or kernels_for(self.texels.device).render

    def forward(self, units: Tensor) -> Tensor:
        """Return colours (r, 3) in [0, 1] of unit directions (r, 3)."""
        rgb = torch.sigmoid(self._kernels.look(self.texels, units, self.config.sizes))
        self._units, self._rgb = units, rgb
        return rgb

    def backward(self, d_rgb: Tensor) -> None:
        """Set the texels' gradient from that of the last `forward`'s colours, (r, 3)."""
        assert self.texels.grad is not None
        d_sums = d_rgb * self._rgb * (1 - self._rgb)
        self._kernels.paint(d_sums, self._units, self.config.sizes, self.texels.grad)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name; a backward pass sets their `.grad`."""
        return {"texels": self.texels}
