"""Sun, sky and haze: what light arrives, what a surface sends back, what the air does to it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.materials import Material
from priors.street.noise import band

Floats = npt.NDArray[np.floating]
SUN_COLOUR = np.array([1.0, 0.94, 0.83], np.float32)
SKY_COLOUR = np.array([0.66, 0.80, 1.0], np.float32)
HORIZON_COLOUR = np.array([0.96, 0.98, 1.0], np.float32)
GROUND_COLOUR = np.array([0.9, 0.84, 0.75], np.float32)
CLOUDS = ((2.9, 0.5), (1.1, 0.3), (0.37, 0.17), (0.12, 0.08))
"""Wavelength and strength of what clouds are summed from."""
SHINE = np.zeros((len(Material), 2), np.float32)
"""Reflection seen head-on and at grazing angles, by material."""
SHINE[Material.GLASS] = 0.10, 0.9
SHINE[Material.CAR_GLASS] = 0.10, 0.9
SHINE[Material.PAINT] = 0.07, 0.75
SHINE[Material.METAL] = 0.10, 0.4
SHINE[Material.RIM] = 0.12, 0.4
SHINE[Material.LAMP] = 0.10, 0.6
SHINE[Material.PLATE] = 0.02, 0.3
SHINE[Material.RUBBER] = 0.01, 0.15
SHINE[Material.ASPHALT] = 0.0, 0.12
LEAST_SHINE = 0.004
"""Reflections weaker than this are left out."""
MIRRORS = (Material.PAINT, Material.CAR_GLASS, Material.GLASS, Material.METAL, Material.RIM, Material.LAMP)


@dataclass(frozen=True, slots=True)
class Surface:
    """Places that the eye sees, ready for light; n of them."""

    albedo: Floats
    """(n, 3) linear RGB."""
    material: npt.NDArray[np.uint8]
    """(n,)"""
    normal: Floats
    """(n, 3) unit, towards the eye."""
    view: Floats
    """(n, 3) unit, from the eye to the surface."""
    lit: Floats
    """(n,) share of the sun that arrives, 0..1."""
    open: Floats
    """(n,) share of the sky that is seen, 0..1."""

    def pick(self, at: npt.NDArray[np.int64]) -> "Surface":
        """Return some of the places."""
        return Surface(*(getattr(self, name)[at] for name in Surface.__slots__))


class Light:
    """The light of one world."""

    def __init__(self, config: StreetConfig) -> None:
        azimuth, height = config.sun_azimuth_rad, config.sun_elevation_rad
        flat = np.cos(height)
        self.to_sun = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height)], np.float32)
        self._config = config
        self._sun = np.float32(2.7 * config.sun_strength) * SUN_COLOUR
        self._ambient = np.float32(0.30 + 0.85 * (1 - min(config.sun_strength, 1.0)))

    def sky(self, directions: Floats) -> Floats:
        """Return radiance (n, 3) of the sky in unit directions (n, 3): gradient, clouds, glow around the sun."""
        up = np.maximum(directions[:, 2], 0.0)
        clear = np.exp(-3.5 * up)[:, None]
        blue = HORIZON_COLOUR * clear + SKY_COLOUR * np.float32(0.62) * (1 - clear)
        plane = directions[:, :2] / (up + np.float32(0.12))[:, None]
        key = np.full(len(up), self._config.seed % 97, np.float32)
        puffs = np.zeros(len(up), np.float32)
        for number, (wave, gain) in enumerate(CLOUDS):
            puffs += np.float32(gain) * band(plane, wave, key, number)
        cover = np.clip(1.4 * (puffs + 1.6 * self._config.cloud_cover - 0.8) + 0.5, 0, 1)[:, None]
        cloud = np.float32(1.0) - np.float32(0.22) * np.clip(puffs, 0, 1)[:, None]
        glow = np.clip(directions @ self.to_sun, 0, 1)[:, None] ** 24 * np.float32(self._config.sun_strength)
        return (blue * (1 - cover) + cloud * cover + glow) * np.float32(self._config.sky_strength)

    def shade(self, surface: Surface) -> Floats:
        """Return what surfaces send towards the eye, radiance (n, 3)."""
        facing = surface.normal @ self.to_sun
        leafy = surface.material == Material.LEAF
        # Leaves let light through and are crumpled: they are never quite dark on the far side.
        diffuse = np.maximum(facing, 0)
        diffuse[leafy] = 0.5 * diffuse[leafy] + 0.5 * np.abs(facing[leafy])
        above = (0.5 + 0.5 * surface.normal[:, 2])[:, None]
        bounce = np.float32(0.22 + 0.13 * self._config.sun_strength) * GROUND_COLOUR
        ambient = self._ambient * (SKY_COLOUR * above + bounce * (1 - above)) * (0.06 + 1.1 * surface.open)[:, None]
        ambient[leafy] *= 1.5
        out = surface.albedo * (self._sun * (diffuse * surface.lit)[:, None] + ambient)
        along = np.abs(np.einsum("ni,ni->n", surface.normal, surface.view))
        low, high = SHINE[surface.material].T
        strength = low + (high - low) * (1 - along) ** 5
        shiny = np.flatnonzero(strength > LEAST_SHINE)
        if shiny.size:
            out[shiny] += self._reflection(surface.pick(shiny), strength[shiny])
        return out

    def _reflection(self, surface: Surface, strength: Floats) -> Floats:
        along = np.einsum("ni,ni->n", surface.normal, surface.view)
        mirrored = surface.view - 2 * along[:, None] * surface.normal
        # What is mirrored near the horizon is the other side of the street, not the sky.
        azimuth = np.arctan2(mirrored[:, 1], mirrored[:, 0]).astype(np.float32)
        ring = np.stack([azimuth, mirrored[:, 2]], axis=1)
        key = np.full(len(ring), 5.0, np.float32)
        skyline = 0.20 + 0.05 * band(ring, 0.8, key)
        street = np.clip(5 * (mirrored[:, 2] - skyline), 0, 1)[:, None]
        houses = np.float32(0.13) * GROUND_COLOUR * np.exp(0.5 * band(ring, 0.25, key, 2))[:, None]
        houses = np.where(mirrored[:, 2:] < 0, np.float32(0.16) * GROUND_COLOUR, houses)
        reflected = self.sky(mirrored) * street + houses * (1 - street)
        glossy = np.isin(surface.material, MIRRORS)
        spot = np.clip(mirrored @ self.to_sun, 0, 1) ** 220 * glossy * surface.lit * 8
        return reflected * (strength * (0.25 + 0.75 * surface.open))[:, None] + (strength * spot)[:, None] * self._sun

    def haze(self, radiance: Floats, distance_m: Floats) -> Floats:
        """Mix in what the air scatters over distances (n,)."""
        through = np.exp(-distance_m / np.float32(self._config.haze_m))[:, None]
        return radiance * through + HORIZON_COLOUR * np.float32(0.8 * self._config.sky_strength) * (1 - through)


def develop(radiance: Floats, exposure: float, warmth: float, saturation: float) -> Floats:
    """Turn radiance (..., 3) into display values 0..255: exposure, colour, a curve with a little toe, clipping."""
    balance = np.array([1 + warmth, 1.0, 1 - warmth], np.float32)
    x = radiance * balance * np.float32(exposure)
    grey = x.mean(axis=-1, keepdims=True)
    x = np.clip(grey + np.float32(saturation) * (x - grey), 0, 1)
    curve = x ** np.float32(1 / 2.1)
    return np.asarray(255 * (0.01 + 0.99 * curve * (0.80 + 0.20 * curve)), np.float32)
