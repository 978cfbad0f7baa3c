"""Backdrop: the sky behind Gaussians, coloured by direction alone, painted from the images before the first step."""

import numpy as np
import torch
from torch import Tensor

from nerf.gaussians.shot import Directions, rotation_of
from nerf.gaussians.types import Behind, Viewpoint
from nerf.scene import Scene
from nerf.sky import Sky, SkyConfig
from nerf.twin.sky import corners
from priors.sky import sky_mask

CLEAR, TRAINED = 1e-3, 1e-2
"""A pixel through which less light passes shows no sky, and none to learn from."""
MOST_PIXELS, MOST_FRAMES = 2048, 64
"""Pixels of a frame, and frames, that are looked at before the first step."""
DARK, LIGHT = 0.02, 0.98
"""Colours of the sky at the start: a sigmoid reaches neither 0 nor 1."""
SEEN = 0.05
"""Weight from which on a texel has been seen."""


class Backdrop:
    """A sky that is asked where light passes."""

    def __init__(self, device: torch.device) -> None:
        self.sky, self._directions = Sky(SkyConfig(), device), Directions()

    def behind(self, viewpoint: Viewpoint, change: Tensor | None, clear: float = CLEAR) -> Behind:
        """Return what lies behind Gaussians where more light than a share `clear` passes, and a change (3, 4)."""
        device, sky = self.sky.texels.device, self.sky
        units, rotation = self._directions.of(viewpoint.camera, device), rotation_of(viewpoint, device)
        return Behind(sky.texels, sky.config.sizes, units, rotation, change, clear)

    def learn(self, d_texels: Tensor) -> None:
        """Set the sky's gradient."""
        assert self.sky.texels.grad is not None
        self.sky.texels.grad.copy_(d_texels)

    def paint(self, scene: Scene) -> None:
        """Paint the sky by the training frames' sky pixels; each picture has what the coarser ones lack.

        Where no frame shows sky it stays grey.
        """
        units, rgb = self._look(scene)
        wanted, start = torch.logit(rgb.clamp(DARK, LIGHT)), 0
        for size in self.sky.config.sizes if len(units) else ():
            rows, shares = corners(units, (size,))
            total, weight = torch.zeros(size * size, 3), torch.zeros(size * size)
            total.index_add_(0, rows.flatten(), (shares[..., None] * wanted[:, None]).flatten(0, 1))
            weight.index_add_(0, rows.flatten(), shares.flatten())
            texels = torch.where(weight[:, None] > SEEN, total / weight.clamp(min=SEEN)[:, None], 0.0)
            self.sky.texels[start : start + size * size] = texels.to(self.sky.texels.device)
            wanted = wanted - (texels[rows] * shares[..., None]).sum(1)
            start += size * size

    def _look(self, scene: Scene) -> tuple[Tensor, Tensor]:
        """Return directions (n, 3) into the sky, and their colours (n, 3) in [0, 1]."""
        units, rgb = [torch.zeros(0, 3)], [torch.zeros(0, 3)]
        for position in scene.train[:: -(-len(scene.train) // MOST_FRAMES)]:
            image = np.asarray(scene.images[position])
            mask = sky_mask(image) if scene.sky is None else np.asarray(scene.sky[position]) > 0
            every = np.flatnonzero(mask)
            flat = torch.from_numpy(every[:: max(1, -(-len(every) // MOST_PIXELS))])
            units.append(self._directions(Viewpoint(scene.camera, scene.T_world_cam[position]), flat))
            rgb.append(torch.from_numpy(image.reshape(-1, 3)).float()[flat] / 255)
        return torch.cat(units), torch.cat(rgb)
