"""Albedo of every material as a function of the place on the surface: aperiodic, many octaves, filtered by footprint.

A painter takes a Patch, the rays that met one material, and returns linear RGB albedo (n, 3).
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from priors.street import paint_ground as ground
from priors.street import paint_houses as houses
from priors.street import paint_things as things
from priors.street.materials import Material
from priors.street.patch import Floats, Patch

PAINTERS: dict[Material, Callable[[Patch], Floats]] = {
    Material.ASPHALT: ground.asphalt,
    Material.PAVEMENT: ground.pavement,
    Material.KERB: ground.kerb,
    Material.GRASS: ground.grass,
    Material.PLASTER: houses.plaster,
    Material.BRICK: houses.brick,
    Material.ROOF: houses.roof,
    Material.GLASS: houses.glass,
    Material.DOOR: houses.door,
    Material.PAINT: things.paint,
    Material.CAR_GLASS: things.car_glass,
    Material.RUBBER: things.plain,
    Material.METAL: things.metal,
    Material.BARK: things.bark,
    Material.LEAF: things.leaf,
    Material.SIGN: things.sign,
    Material.PLAIN: things.plain,
    Material.LAMP: things.lamp,
    Material.FAR: houses.far,
    Material.RIM: things.rim,
    Material.PLATE: things.plate,
    Material.SHOP: houses.shop,
    Material.CLOTH: things.cloth,
}


def albedo(material: npt.NDArray[np.uint8], patch: Patch) -> Floats:
    """Paint places (n,) of mixed materials: linear RGB (n, 3)."""
    out = np.zeros((len(material), 3), np.float32)
    for kind in np.unique(material):
        at = np.flatnonzero(material == kind)
        part = Patch(patch.uv[at], patch.key[at], patch.tint[at], patch.footprint[at], patch.config)
        out[at] = PAINTERS[Material(kind)](part)
    return out
