"""Shot: a training frame as a step sees it, a whole image with what is known of it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.types import Viewpoint
from nerf.losses import LossConfig, prior_weight
from nerf.scene import Scene
from nerf.types import Rays
from priors.geometry import rays as pixel_rays
from priors.types import Camera

KEPT_BYTES = 256 << 20
"""Frames of so many bytes are kept."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One view; tensors on one device."""

    position: int | None
    """Which of the scene's frames; None: a virtual view."""
    viewpoint: Viewpoint
    rgb: Tensor
    """(h, w, 3) in [0, 1]."""
    depth_m: Tensor | None
    """(h, w) the prior, metres, 0 = no value; None without a prior."""
    weight: Tensor | None
    """(h, w) how much the prior counts, 0 where it has no value; None without a prior."""
    sky: Tensor | None
    """(h, w) 1 where the image shows sky; None: nobody knows."""
    counts: Tensor | None = None
    """(h, w) how much a pixel's colour counts; None: all alike."""
    frame: int | None = None
    """Its number among the training frames; None: a virtual view."""
    share: float = 1.0
    """Share of the steps that know what this one knows of depth and sky."""

    @property
    def nbytes(self) -> int:
        """How much memory it takes."""
        return sum(x.nbytes for x in (self.rgb, self.depth_m, self.weight, self.sky) if x is not None)


def shot_of(scene: Scene, position: int, rules: LossConfig, device: torch.device) -> Shot:
    """Read a frame."""
    rgb = _on(device, scene.images[position]) / 255
    depth_m = None if scene.depth_m is None else _on(device, scene.depth_m[position])
    trust = None if scene.weight is None else _on(device, scene.weight[position]) / 255
    sky = None if scene.sky is None else _on(device, scene.sky[position])
    weight = prior_weight(rules, Rays(rgb, rgb, depth_m=depth_m, weight=trust))
    viewpoint = Viewpoint(scene.camera, scene.T_world_cam[position])
    return Shot(position, viewpoint, rgb, depth_m, weight, sky, frame=scene.train.index(position))


class Shots:
    """A fit's training frames as steps see them; so many as KEPT_BYTES hold are made once."""

    def __init__(self) -> None:
        self._kept: dict[int, Shot] = {}
        self._of: tuple[Scene, LossConfig] | None = None

    def __call__(self, scene: Scene, position: int, rules: LossConfig, device: torch.device) -> Shot:
        """Return a frame; those of another scene, or by other rules, are forgotten."""
        if self._of is None or self._of[0] is not scene or self._of[1] != rules:
            self._kept, self._of = {}, (scene, rules)
        if position in self._kept:
            return self._kept[position]
        shot = shot_of(scene, position, rules, device)
        if (len(self._kept) + 1) * shot.nbytes <= KEPT_BYTES:
            self._kept[position] = shot
        return shot


def position_at(train: list[int], seed: int, step: int) -> int:
    """Return the frame of a step: each is drawn once, in an order of its own, before any is drawn again."""
    lap, place = divmod(step, len(train))
    order = np.random.Generator(np.random.Philox(key=[seed, lap])).permutation(len(train))
    return train[int(order[place])]


class Directions:
    """Unit directions through a camera's pixels; the last camera's are kept."""

    def __init__(self) -> None:
        self._key: tuple[bytes, tuple[int, int]] | None = None
        self._units = torch.empty(0)

    def __call__(self, viewpoint: Viewpoint, flat: Tensor) -> Tensor:
        """Return unit directions (r, 3) in the scene's frame through pixels (r,), row * width + column."""
        return self.of(viewpoint.camera, flat.device)[flat] @ rotation_of(viewpoint, flat.device).T

    def of(self, camera: Camera, device: torch.device) -> Tensor:
        """Return unit directions (h * w, 3) through all pixels, in the camera's frame."""
        key = camera.K.tobytes(), camera.size
        if key != self._key or self._units.device != device:
            self._key, self._units = key, torch.from_numpy(_units(camera)).to(device)
        return self._units


def rotation_of(viewpoint: Viewpoint, device: torch.device) -> Tensor:
    """Return the rotation (3, 3) from a camera's frame to the scene's."""
    return torch.from_numpy(viewpoint.T_world_cam[:3, :3].astype(np.float32)).to(device)


def _units(camera: Camera) -> npt.NDArray[np.float32]:
    directions = pixel_rays(camera).reshape(-1, 3)
    return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)


def _on(device: torch.device, values: npt.NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(device)
