"""What a volumetric model learns of its training frames beside the field: losses, the prior's scales, colours."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.alignment import Alignment
from nerf.config import FitConfig
from nerf.converged import Converged
from nerf.ray_appearance import RayAppearance
from nerf.scene import Scene
from nerf.state import copy_into, joined, under


@dataclass(frozen=True)
class Learned:
    """What is learned of the training frames."""

    converged: Converged | None = None
    """What is known of the images' losses; None: all rays are trained on."""
    alignment: Alignment | None = None
    """What is learned of the prior; None: it stays as it is."""
    appearance: RayAppearance | None = None
    """What is learned of each frame's colours; None: nothing."""

    @classmethod
    def of(cls, scene: Scene, config: FitConfig, device: torch.device, appearance: bool) -> "Learned":
        """Know nothing yet; `appearance`: learn each frame's colours."""
        converged = Converged.of(scene) if config.model.sampler.roulette_rays < 1 else None
        learns = config.align == "learn" and scene.depth_m is not None
        alignment = Alignment(len(scene.ids), scene.train, device) if learns else None
        return cls(converged, alignment, RayAppearance.of(scene, device) if appearance else None)

    @classmethod
    def like(cls, state: dict[str, Tensor], device: torch.device) -> "Learned":
        """Make what can render a checkpoint's state."""
        alignment = Alignment.like(under("model.alignment", state))
        return cls(None, alignment, RayAppearance.like(under("appearance", state), device))

    @property
    def parts(self) -> dict[str, Alignment | RayAppearance]:
        """What has trainable parameters, by name."""
        named = {"alignment": self.alignment, "appearance": self.appearance}
        return {name: part for name, part in named.items() if part is not None}

    def state(self) -> dict[str, Tensor]:
        """Return the tensors that `load` needs beside the parameters."""
        return joined({name: part.state() for name, part in self._kept().items()})

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state; ValueError where it is of other frames or settings."""
        for name, part in self._kept().items():
            copy_into(part.state(), under(name, state))

    def _kept(self) -> dict[str, Converged | RayAppearance]:
        named = {"converged": self.converged, "appearance": self.appearance}
        return {name: part for name, part in named.items() if part is not None}
