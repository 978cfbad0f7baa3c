"""Sun, sky and haze: what light arrives, what a surface sends back, what the air does to it."""

import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.materials import Material
from priors.street.noise import band

Floats = npt.NDArray[np.float32]
SUN_COLOUR = np.array([1.0, 0.95, 0.86], np.float32)
SKY_COLOUR = np.array([0.62, 0.78, 1.0], np.float32)
HORIZON_COLOUR = np.array([0.95, 0.98, 1.0], np.float32)
GROUND_COLOUR = np.array([0.85, 0.82, 0.76], np.float32)
SHINE = np.zeros((len(Material), 2), np.float32)
"""Reflection seen head-on and at grazing angles, by material."""
SHINE[Material.GLASS] = 0.10, 0.9
SHINE[Material.CAR_GLASS] = 0.09, 0.9
SHINE[Material.PAINT] = 0.05, 0.65
SHINE[Material.METAL] = 0.12, 0.4
SHINE[Material.LAMP] = 0.08, 0.6
SHINE[Material.ASPHALT] = 0.0, 0.10


class Light:
    """The light of one world."""

    def __init__(self, config: StreetConfig) -> None:
        azimuth, height = config.sun_azimuth_rad, config.sun_elevation_rad
        flat = np.cos(height)
        self.to_sun = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height)], np.float32)
        self._config = config
        self._sun = np.float32(2.6 * config.sun_strength) * SUN_COLOUR
        self._sky = np.float32(0.42 + 0.5 * (1 - min(config.sun_strength, 1.0)))

    def sky(self, directions: Floats) -> Floats:
        """Return radiance (n, 3) of the sky in unit directions (n, 3): gradient, clouds, glow around the sun."""
        up = np.maximum(directions[:, 2], 0.0)
        clear = np.exp(-3.5 * up)[:, None]
        blue = HORIZON_COLOUR * clear + SKY_COLOUR * 0.62 * (1 - clear)
        plane = directions[:, :2] / (up + 0.12)[:, None]
        key = np.full(len(up), self._config.seed % 97, np.float32)
        puffs = sum(gain * band(plane, wave, key, i) for i, (wave, gain) in enumerate(((2.9, 0.5), (1.1, 0.3), (0.37, 0.17), (0.12, 0.08))))  # fmt: skip
        cover = np.clip(1.4 * (puffs + 1.6 * self._config.cloud_cover - 0.8) + 0.5, 0, 1)[:, None]
        cloud = np.float32(1.0) - 0.22 * np.clip(puffs, 0, 1)[:, None]
        glow = np.clip(directions @ self.to_sun, 0, 1)[:, None] ** 24 * np.float32(self._config.sun_strength)
        return (blue * (1 - cover) + cloud * cover + glow) * np.float32(1.25)

    def shade(
        self, albedo: Floats, material: npt.NDArray[np.uint8], normal: Floats, view: Floats, lit: Floats, open_: Floats
    ) -> Floats:
        """Return what surfaces send towards the eye, radiance (n, 3).

        Args:
            albedo: (n, 3) linear RGB.
            material: (n,).
            normal: (n, 3) unit, towards the eye.
            view: (n, 3) unit, from the eye to the surface.
            lit: (n,) share of the sun that arrives, 0..1.
            open_: (n,) share of the sky that the surface sees, 0..1.
        """
        facing = normal @ self.to_sun
        leafy = (material == Material.LEAF).astype(np.float32)
        # Leaves let light through and are crumpled: they are never quite dark on the far side.
        diffuse = np.maximum(facing, 0) * (1 - 0.45 * leafy) + 0.45 * leafy * np.abs(facing)
        above = (0.5 + 0.5 * normal[:, 2])[:, None]
        ambient = self._sky * (SKY_COLOUR * above + 0.30 * GROUND_COLOUR * (1 - above)) * open_[:, None]
        out = albedo * (self._sun * (diffuse * lit)[:, None] + ambient)
        shiny = np.flatnonzero(SHINE[material, 1] > 0)
        if shiny.size:
            out[shiny] += self._reflection(material[shiny], normal[shiny], view[shiny], lit[shiny], open_[shiny])
        return out

    def _reflection(
        self, material: npt.NDArray[np.uint8], normal: Floats, view: Floats, lit: Floats, open_: Floats
    ) -> Floats:
        cos = np.abs(np.einsum("ni,ni->n", normal, view))
        mirrored = view - 2 * np.einsum("ni,ni->n", normal, view)[:, None] * normal
        low, high = SHINE[material].T
        strength = low + (high - low) * (1 - cos) ** 5
        # What is mirrored near the horizon is the other side of the street, not the sky.
        street = np.clip(6 * (mirrored[:, 2] - 0.22), 0, 1)[:, None]
        seen = self.sky(mirrored) * street + np.float32(0.10) * GROUND_COLOUR * (1 - street)
        glossy = np.isin(material, (Material.PAINT, Material.CAR_GLASS, Material.GLASS, Material.METAL))
        spot = np.clip(mirrored @ self.to_sun, 0, 1) ** 180 * glossy * lit * 6
        return seen * (strength * open_)[:, None] + (strength * spot)[:, None] * self._sun

    def haze(self, radiance: Floats, distance_m: Floats) -> Floats:
        """Mix in what the air scatters over distances (n,)."""
        through = np.exp(-distance_m / np.float32(self._config.haze_m))[:, None]
        return radiance * through + HORIZON_COLOUR * np.float32(0.9) * (1 - through)


def develop(radiance: Floats, exposure: float, warmth: float) -> Floats:
    """Turn radiance (..., 3) into display values 0..255: exposure, white balance, a contrasty curve that clips."""
    balance = np.array([1 + warmth, 1.0, 1 - warmth], np.float32)
    x = np.maximum(radiance * balance * np.float32(exposure), 0)
    return (255 * np.clip(x, 0, 1) ** np.float32(1 / 1.9)).astype(np.float32)
