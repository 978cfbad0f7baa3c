"""What surfaces are made of, and what a laser sees of them."""

from enum import IntEnum

import numpy as np


class Material(IntEnum):
    """Index of a surface's texture and optics."""

    ASPHALT = 0
    PAVEMENT = 1
    KERB = 2
    GRASS = 3
    PLASTER = 4
    BRICK = 5
    ROOF = 6
    GLASS = 7
    """Window pane of a house, uv 0..1."""
    DOOR = 8
    PAINT = 9
    CAR_GLASS = 10
    RUBBER = 11
    METAL = 12
    BARK = 13
    LEAF = 14
    SIGN = 15
    """A road sign's plate, uv -1..1."""
    PLAIN = 16
    """Matt, lightly mottled: frames, sills, plastics."""
    LAMP = 17
    """Head and tail lights."""
    FAR = 18
    """Distant houses and hills."""
    RIM = 19
    """A wheel rim, uv -1..1."""
    PLATE = 20
    """A number plate, uv 0..1."""
    SHOP = 21
    """A shop's sign board or awning."""
    CLOTH = 22
    """Clothes and skin."""


LAST_GROUND = Material.GRASS
"""The materials up to this one lie flat."""
CURVED = np.zeros(len(Material), np.bool_)
"""What may have normals of its own."""
CURVED[
    [Material.PAINT, Material.CAR_GLASS, Material.METAL, Material.BARK, Material.PLAIN, Material.RUBBER, Material.CLOTH]
] = True
LASER_RETURN = np.ones(len(Material), np.float32)
"""Chance of an echo at normal incidence and short range, by material."""
LASER_RETURN[[Material.GLASS, Material.CAR_GLASS]] = 0.15, 0.1
LASER_RETURN[[Material.RUBBER, Material.PAINT]] = 0.8, 0.9
LASER_RETURN[Material.LEAF] = 0.93
