"""Which parts of the training images are learned already. Their rays are drawn less often, with a larger weight.

Images are cut into tiles, and each tile keeps a running mean of its rays' loss. A ray's gradient goes with the root of
its loss, so that is what roulette weighs by (nerf.roulette): rays of tiles that are no better than the batch's mean
are all drawn. The weights undo it: the expected gradient is that of even drawing.
"""

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf import roulette
from nerf.scene import Pixels, Scene
from nerf.state import copy_into
from nerf.types import Key

TILE, MOST_TILES = 8, 1 << 20
"""Side of a tile, pixels; larger where a scene would have more tiles than that."""
MEMORY = 0.8
"""What a tile's mean keeps of itself when its rays are seen again."""


class Converged:
    """A running mean loss for each tile of a scene's frames."""

    def __init__(self, shape: tuple[int, int, int], side: int) -> None:
        """Know nothing of (frames, rows, columns) tiles of `side` pixels."""
        self.side = side
        self.loss = torch.full(shape, -1.0)
        """Mean of the rays' loss; -1: no ray was drawn yet."""

    @classmethod
    def of(cls, scene: Scene) -> "Converged":
        """Know nothing of a scene."""
        frames, (height, width) = len(scene.ids), scene.camera.size
        side = max(TILE, math.ceil(math.sqrt(frames * height * width / MOST_TILES)))
        return cls((frames, -(-height // side), -(-width // side)), side)

    def spin(self, pixels: Pixels, least: float, key: Key) -> tuple[Pixels, Tensor]:
        """Choose which of evenly drawn pixels become rays, each at least with probability `least`.

        Returns:
            the pixels (r,), and the share (r,) that each has in the batch's mean; they sum to 1 on average.
        """
        loss = self.loss.view(-1)[self._tiles(pixels)]
        known = loss >= 0
        chance = torch.ones_like(loss)
        if known.any():
            chance[known] = roulette.chances(torch.sqrt(loss[known]), least)
        kept = roulette.spin(chance, key, roulette.RAYS)
        chosen = kept.numpy()
        return Pixels(*(x[chosen] for x in pixels)), 1 / (len(loss) * chance[kept])

    def learn(self, pixels: Pixels, loss: Tensor) -> None:
        """Note the loss (r,) of rays through pixels."""
        tile, place = torch.unique(self._tiles(pixels), return_inverse=True)
        total = torch.zeros(len(tile)).index_add_(0, place, loss)
        mean = total / torch.bincount(place, minlength=len(tile))
        before = self.loss.view(-1)[tile]
        self.loss.view(-1)[tile] = torch.where(before < 0, mean, MEMORY * before + (1 - MEMORY) * mean)

    def state(self) -> dict[str, Tensor]:
        """Return what `load` needs to go on bit for bit."""
        return {"loss": self.loss}

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state; ValueError where it is of a scene of another size."""
        copy_into(self.state(), state)

    def _tiles(self, pixels: Pixels) -> Tensor:
        """Return the flat places (r,) of the tiles of pixels."""
        rows, columns = pixels.row // self.side, pixels.column // self.side
        flat: npt.NDArray[np.int64] = np.ravel_multi_index((pixels.frame, rows, columns), tuple(self.loss.shape))
        return torch.from_numpy(flat)
