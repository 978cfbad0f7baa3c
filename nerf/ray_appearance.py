"""Appearance of a hash field: the changes of colour of nerf/gaussians/appearance.py, learned ray by ray.

A ray of a training frame shows A c + b of the rendered colour c (Urban Radiance Fields, Rematas et al., CVPR 2022,
section 3.2). A - 1 and b are parameters beside the field's own; the loss has PULL times their squares, so that a frame
is held to no change as firmly as its rays pull at it.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.appearance import PULL, Appearance
from nerf.scene import Scene
from nerf.types import Gradients, Rendered
from nerf.world import here


class RayAppearance:
    """The changes of colour of a scene's training frames."""

    def __init__(self, frames: Appearance) -> None:
        """Take the frames and their changes."""
        self._frames = frames
        frames.change.grad = torch.zeros_like(frames.change)

    @classmethod
    def of(cls, scene: Scene, device: torch.device) -> "RayAppearance":
        """Change nothing yet."""
        return cls(Appearance(scene.T_world_cam[scene.train], device))

    @classmethod
    def like(cls, state: dict[str, Tensor], device: torch.device) -> "RayAppearance | None":
        """Make one that can load a saved state, `state()` beside `parameters()`; None where none was learned."""
        return cls(Appearance(state["poses"].double().numpy(), device)) if "poses" in state else None

    @property
    def change(self) -> Tensor:
        """(n, 3, 4) A - 1 and b of each training frame."""
        return self._frames.change

    def at(self, rgb: Tensor, T_world_cam: npt.NDArray[np.float64]) -> Tensor:
        """Return colours (r, 3) as a view shows them: a training frame as itself, others as the two nearest."""
        return shown(rgb, self._frames.at(T_world_cam))

    def seen(self, rendered: Rendered, which: Tensor) -> Rendered:
        """Return rendered rays as their training frames show them; which (r,): number of each ray's frame."""
        return replace(rendered, rgb=shown(rendered.rgb, self.change[which]))

    def backward(self, rgb: Tensor, which: Tensor, gradients: Gradients) -> None:
        """Set the changes' gradient, and turn the derivatives by shown colours into those by rendered ones, rgb (r, 3).

        The processes of a fit add up their gradients, so each adds its share of the pull.
        """
        d_shown, change, grad = gradients.rgb, self.change, self.change.grad
        assert grad is not None
        grad.zero_().index_add_(0, which, torch.cat([d_shown[:, :, None] * rgb[:, None], d_shown[:, :, None]], dim=2))
        rays = torch.bincount(which, minlength=len(change))
        grad.add_(rays[:, None, None] / here().total(rays.sum()) * 2 * PULL * change)
        gradients.rgb.copy_(d_shown + torch.einsum("ri,rij->rj", d_shown, change[which, :, :3]))

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""
        return {"change": self.change}

    def state(self) -> dict[str, Tensor]:
        """Return what says of which frames the changes are: (n, 4, 4) poses."""
        return {"poses": self._frames.poses}


def shown(rgb: Tensor, change: Tensor) -> Tensor:
    """Return colours (r, 3) after a change (3, 4), or after one of each ray (r, 3, 4)."""
    return rgb + torch.einsum("...ij,...j->...i", change[..., :3], rgb) + change[..., 3]


def numbers(scene: Scene, frame: npt.NDArray[np.int64]) -> Tensor:
    """Return which training frames the frames (r,) of rays are, (r,)."""
    return torch.from_numpy(np.searchsorted(np.asarray(scene.train), frame))
