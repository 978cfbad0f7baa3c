"""What lies flat: road, kerbs, pavements, lots, side streets."""

import numpy as np

from priors.street import mesh
from priors.street.config import KERB_HEIGHT_M, KERB_M, StreetConfig
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

STRIP_STEP_M = 2.0
"""Length of the pieces that a strip is made of."""
LOT_M = 70.0
ASPHALT_TINT, SLAB_TINT, KERB_TINT = [0.125, 0.123, 0.122], [0.22, 0.212, 0.20], [0.28, 0.27, 0.255]
GRASS_TINT = [0.062, 0.078, 0.026]


def strip(s: tuple[float, float], t: tuple[float, float], z: tuple[float, float], finish: Finish) -> Mesh:
    """Make a strip along the street from t[0] at height z[0] to t[1] at z[1], in pieces so that it can bend."""
    cuts = np.linspace(*s, max(2, int(np.ceil((s[1] - s[0]) / STRIP_STEP_M)) + 1))
    a, b = cuts[:-1], cuts[1:]
    low, high = (np.broadcast_to(np.array([tt, zz]), (len(a), 2)) for tt, zz in zip(t, z, strict=True))
    corners = np.stack([np.column_stack([x, side]) for x, side in ((a, low), (b, low), (b, high), (a, high))], axis=1)
    return mesh.quads(corners, finish)


def road(config: StreetConfig, s: tuple[float, float]) -> Mesh:
    """Make the carriageway with its parking strips."""
    return strip(s, (-config.kerb_m(-1), config.kerb_m(1)), (0.0, 0.0), Finish(Material.ASPHALT, ASPHALT_TINT))


def block_side(
    config: StreetConfig, s: tuple[float, float], side: int, garden: bool, key: float, lot_m: float = LOT_M
) -> list[Mesh]:
    """Make kerb, pavement and the lots behind it, as far as lot_m from the centre line, along one side of a block."""
    kerb, front, h = config.kerb_m(side), config.front_m(side), KERB_HEIGHT_M
    inner = kerb + KERB_M
    lot = (Material.GRASS, GRASS_TINT) if garden else (Material.PAVEMENT, SLAB_TINT)
    return [
        strip(s, (side * kerb, side * (kerb + 0.015)), (0.0, h), Finish(Material.KERB, KERB_TINT, key)),
        strip(s, (side * (kerb + 0.015), side * inner), (h, h), Finish(Material.KERB, KERB_TINT, key)),
        strip(s, (side * inner, side * front), (h, h), Finish(Material.PAVEMENT, SLAB_TINT, key)),
        strip(s, (side * front, side * lot_m), (h, h), Finish(*lot, key)),
        *_returns(s, (side * kerb, side * lot_m), h),
    ]


def _returns(s: tuple[float, float], t: tuple[float, float], height: float) -> list[Mesh]:
    """Make the kerbs along the side streets at both ends of a block, from t[0] to t[1]."""
    faces = [[(x, t[0], 0), (x, t[1], 0), (x, t[1], height), (x, t[0], height)] for x in s]
    return [mesh.quads(faces, Finish(Material.KERB, KERB_TINT))]


def side_street(config: StreetConfig, s: tuple[float, float], side: int) -> Mesh:
    """Make the road surface of a gap between two blocks."""
    kerb = config.kerb_m(side)
    return strip(s, (side * kerb, side * (LOT_M + 50)), (0.0, 0.0), Finish(Material.ASPHALT, ASPHALT_TINT, 40.0))


def terrain(config: StreetConfig, behind_m: float) -> Mesh:
    """Make the land around: flat, straight, and below whatever the street's slopes reach."""
    x, y = (-behind_m - 900, config.length_m + 900), 950.0
    corners = [(x[0], -y, -3.0), (x[1], -y, -3.0), (x[1], y, -3.0), (x[0], y, -3.0)]
    return mesh.quads([corners], Finish(Material.GRASS, GRASS_TINT, 77.0))
