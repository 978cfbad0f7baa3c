"""Scene: posed frames and a prior's maps, arrays or files that are never held whole.

Its frame is the drive's metric frame, less an origin where the drive is far from zero (priors/origin.py).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from nerf.evidence.corrected import Corrected
from nerf.stack import Stack
from nerf.types import Rays
from priors import origin
from priors.geometry import rays as pixel_rays
from priors.origin import Offset
from priors.types import Camera, Matrix


class Pixels(NamedTuple):
    """Pixels of a scene's frames, (r,) int64 each."""

    frame: npt.NDArray[np.int64]
    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Scene:
    """Frames with poses and, where a prior is given, its depth; arrays or, on disk, stacks."""

    name: str
    ids: list[str]
    camera: Camera
    T_world_cam: npt.NDArray[np.float64]
    """(frames, 4, 4) in the scene's frame, metres."""
    images: Stack | npt.NDArray[np.uint8]
    """(frames, height, width, 3)"""
    depth_m: Stack | Corrected | npt.NDArray[np.float32] | None
    """(frames, height, width) the prior, 0 = no value; frames the prior lacks are all 0."""
    weight: Stack | npt.NDArray[np.uint8] | None
    """(frames, height, width) the prior's confidence x 255."""
    train: list[int]
    """Positions of the training frames."""
    test: list[int]
    """Positions of the held-out frames."""
    origin_m: Offset = origin.NONE
    """Where the scene's frame begins in the drive's, metres."""
    sky: Stack | npt.NDArray[np.uint8] | None = None
    """(frames, height, width) 1 where the image shows sky and the prior is not sure of a surface."""
    around: tuple[int, int] | None = None
    """First frame, and the one after the last, of those that a field's space is laid around; None: all."""
    guessed: bool = False
    """Whether the prior's values of low confidence are guesses, most of them too near (nerf/guide.py)."""

    @property
    def path(self) -> npt.NDArray[np.float64]:
        """The poses that a field's space is laid around, (n, 4, 4)."""
        return self.T_world_cam if self.around is None else self.T_world_cam[slice(*self.around)]

    def draw(self, count: int, seed: int, step: int) -> Rays:
        """Draw `count` training rays; the same seed and step draw the same ones."""
        return self.rays(*self.pixels(count, seed, step))

    def pixels(self, count: int, seed: int, step: int) -> Pixels:
        """Draw `count` pixels of the training frames, evenly."""
        height, width = self.camera.size
        random = np.random.Generator(np.random.Philox(key=[seed, step]))
        flat = random.integers(0, len(self.train) * height * width, count)
        which, pixel = np.divmod(flat, height * width)
        frame = np.asarray(self.train)[which]
        return Pixels(frame, *np.divmod(pixel, width))

    def rays(self, frame: npt.NDArray[Any], row: npt.NDArray[Any], column: npt.NDArray[Any]) -> Rays:
        """Return the rays through pixels, (r,) each, with colour and prior."""
        K = self.camera.K
        x, y = (column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1]
        pose = self.T_world_cam[frame]
        directions = np.einsum("rij,rj->ri", pose[:, :3, :3], np.stack([x, y, np.ones_like(x)], axis=1))
        depth_m = None if self.depth_m is None else _tensor(self.depth_m[frame, row, column])
        weight = None if self.weight is None else _tensor(self.weight[frame, row, column] / np.float32(255))
        rgb = _tensor(self.images[frame, row, column] / np.float32(255))
        sky = None if self.sky is None else _tensor(self.sky[frame, row, column])
        pixel = 1 / self.camera.fx
        return Rays(_tensor(pose[:, :3, 3]), _tensor(directions), rgb, depth_m, weight, pixel, sky=sky)


def view_rays(camera: Camera, T_world_cam: Matrix) -> Rays:
    """Return the rays of a whole view, row by row; no colour, no prior."""
    directions = pixel_rays(camera).reshape(-1, 3) @ T_world_cam[:3, :3].T
    origins = np.broadcast_to(T_world_cam[:3, 3], directions.shape)
    return Rays(_tensor(origins), _tensor(directions), pixel=1 / camera.fx)


def _tensor(array: npt.NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
