"""Corrected maps: a prior's maps as the check leaves them, made when they are read."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nerf.stack import Stack

LEAST_TRUST = 102
"""Trust x 255 below which a value is left out: four votes against six."""


class Corrected:
    """Maps times a factor a frame, without the values that are not trusted; read as a nerf.stack.Stack is."""

    def __init__(
        self,
        depth_m: Stack | npt.NDArray[np.float32],
        trust: Stack | npt.NDArray[np.uint8] | None,
        factors: npt.NDArray[np.float32],
    ) -> None:
        """Take maps and their trust x 255, (frames, h, w) each, and the factors (frames,); no trust: all is trusted."""
        self._depth_m, self._trust, self._factors = depth_m, trust, factors
        self.shape = depth_m.shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int | tuple[npt.NDArray[Any], ...]) -> npt.NDArray[np.float32]:
        """Return a frame, or pixels by arrays (n,) of frame, row and column; always a copy."""
        frame = index[0] if isinstance(index, tuple) else index
        depth_m = self._depth_m[index] * self._factors[frame]
        if self._trust is not None:
            depth_m = np.where(self._trust[index] >= LEAST_TRUST, depth_m, np.float32(0))
        return np.asarray(depth_m, np.float32)
