"""Trees, bushes and hedges: foliage is a cloud of small crumpled faces, so that outlines are ragged."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

LEAF_TINTS = np.array(
    [[0.055, 0.10, 0.020], [0.075, 0.115, 0.025], [0.040, 0.080, 0.022], [0.12, 0.12, 0.03], [0.15, 0.09, 0.03]]
)


class Foliage(NamedTuple):
    """The leaves of one crown."""

    number: int
    """How many."""
    leaf_m: float
    """Half the size of a leaf."""
    tint: npt.NDArray[np.floating]
    """(3,) linear RGB."""
    blobs: int
    """How many balls of leaves the crown is made of."""


def leaves(
    rng: np.random.Generator, centres: npt.NDArray[np.floating], outward: npt.NDArray[np.floating], size_m: float,
    tint: npt.NDArray[np.floating], shade: npt.NDArray[np.floating],
) -> Mesh:  # fmt: skip
    """Put a crumpled quad at every centre (n, 3), facing roughly outward (n, 3); shade (n,) dims its colour."""
    n = len(centres)
    facing = outward + rng.normal(0, 0.6, (n, 3))
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    right = np.cross(facing, rng.normal(0, 1, (n, 3)))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(facing, right)
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * rng.uniform(0.35, 1.15, (n, 4, 2))
    size = size_m * rng.uniform(0.5, 1.3, (n, 1, 1))
    quad = centres[:, None] + size * (corner[..., :1] * right[:, None] + corner[..., 1:] * up[:, None])
    quad += size * rng.normal(0, 0.25, (n, 4, 3))
    colour = tint * rng.uniform(0.6, 1.4, (n, 1)) * rng.uniform(0.9, 1.1, (n, 3)) * shade[:, None]
    return mesh.quads(quad, Finish(Material.LEAF, colour, rng.uniform(0, 100, n)), corner * size)


def crown(
    rng: np.random.Generator, centre: npt.NDArray[np.floating], radii: npt.NDArray[np.floating], foliage: Foliage
) -> Mesh:
    """Build a crown from blobs of leaves that are scattered through an ellipsoid, metres."""
    count, leaf_m, tint, blobs = foliage
    direction = rng.normal(0, 1, (blobs, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = direction * rng.uniform(0.25, 0.8, (blobs, 1)) * radii
    size = rng.uniform(0.2, 0.5, (blobs, 1)) * radii
    which = rng.integers(blobs, size=count)
    hue = rng.uniform(0.75, 1.25, (blobs, 1)) * rng.uniform(0.9, 1.1, (blobs, 3))
    ball = rng.normal(0, 1, (count, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    depth = rng.uniform(0, 1, (count, 1)) ** 0.4
    place = middle[which] + ball * depth * size[which]
    inside = np.linalg.norm(place / radii, axis=1)
    return leaves(rng, centre + place, ball, leaf_m, tint * hue[which], np.clip(0.45 + 0.6 * inside, 0.4, 1.1))


def tree(rng: np.random.Generator, leaf_m: float = 0.115) -> Mesh:
    """Build a tree that stands at the origin: trunk, branches, and a crown of leaves of a half size."""
    height = rng.uniform(5.5, 12.0)
    clear = rng.uniform(1.9, 2.8)
    radius = rng.uniform(0.10, 0.20) * height / 8
    spread = height * rng.uniform(0.20, 0.34)
    tint = LEAF_TINTS[rng.choice(len(LEAF_TINTS), p=[0.35, 0.25, 0.25, 0.1, 0.05])]
    centre = np.array([0, 0, 0.5 * (clear + height)])
    radii = np.array([spread, spread, 0.5 * (height - clear)])
    fork = np.array([*rng.normal(0, 0.12, 2), clear * 1.1])
    bark = np.array([0.10, 0.085, 0.07]) * rng.uniform(0.6, 1.4)
    parts = [
        mesh.tube([0, 0, -0.2], fork, (radius * 1.2, radius * 0.9), Finish(Material.BARK, bark, rng.uniform(0, 99)), 9)
    ]
    for _ in range(8):
        out = rng.normal(0, 1, 3)
        tip = centre + rng.uniform(0.3, 0.8) * out / np.linalg.norm(out) * radii
        parts.append(
            mesh.tube(fork, tip, (radius * 0.5, radius * 0.08), Finish(Material.BARK, bark, rng.uniform(0, 99)), 5)
        )
    count = int(3.0 * height * spread / leaf_m**2)
    parts.append(crown(rng, centre, radii, Foliage(count, leaf_m, tint, int(rng.integers(12, 26)))))
    return mesh.merge(parts)


def bush(rng: np.random.Generator) -> Mesh:
    """Build a bush that stands at the origin."""
    radii = np.array([rng.uniform(0.5, 1.3), rng.uniform(0.5, 1.2), rng.uniform(0.5, 1.2)])
    tint = LEAF_TINTS[rng.integers(len(LEAF_TINTS))]
    return crown(rng, np.array([0, 0, 0.8 * radii[2]]), radii, Foliage(1200, 0.06, tint, 9))


def hedge(rng: np.random.Generator, length_m: float, height_m: float, depth_m: float = 0.8) -> Mesh:
    """Build a hedge from x = 0 to its length, y = 0 to its depth: leaves on a dark core."""
    count = int(110 * length_m * (2 * height_m + depth_m))
    place = rng.uniform(0, 1, (count, 3)) * [length_m, depth_m, height_m]
    face = rng.choice(3, size=count, p=[0.55, 0.1, 0.35])
    outward = np.zeros((count, 3))
    outward[face == 0, 1], outward[face == 1, 1], outward[face == 2, 2] = -1, 1, 1
    bumps = 0.08 * np.sin(place[:, 0] * 2.3 + 1.7 * np.sin(place[:, 0])) + rng.normal(0, 0.05, count)
    place[face == 0, 1], place[face == 1, 1] = bumps[face == 0], depth_m + bumps[face == 1]
    place[face == 2, 2] = height_m + bumps[face == 2]
    tint = LEAF_TINTS[rng.integers(3)] * rng.uniform(0.7, 1.2)
    core = mesh.bar([0, 0.15, 0], [length_m, depth_m - 0.1, height_m - 0.15], Finish(Material.LEAF, tint * 0.5, 3.0))
    return mesh.merge([core, leaves(rng, place, outward, 0.07, tint, rng.uniform(0.6, 1.1, count))])
