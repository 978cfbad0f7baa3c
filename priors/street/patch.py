"""A patch of surface to paint, and the mottling that most materials share."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.noise import octaves

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Patch:
    """Places on surfaces of one material."""

    uv: Floats
    """(n, 2) surface coordinates, metres; across a pane 0..1."""
    key: Floats
    """(n,) what tells objects apart."""
    tint: Floats
    """(n, 3) linear RGB."""
    footprint: Floats
    """(n,) what a pixel covers, metres."""
    config: StreetConfig


def mottled(patch: Patch, waves: tuple[float, ...], gains: tuple[float, ...], strength: float = 1.0) -> Floats:
    """Return the tint times exp(noise), (n, 3)."""
    field = octaves(patch.uv, patch.key, patch.footprint, waves, gains)
    return patch.tint * np.exp(np.float32(strength) * field)[:, None]
