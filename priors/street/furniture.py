"""What stands on pavements: lamp posts, signs, bollards, bins, garden walls, fences."""

import numpy as np

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

GREY = [0.20, 0.21, 0.21]


def lamp_post(rng: np.random.Generator) -> Mesh:
    """Build a street lamp whose arm reaches over -y."""
    height, reach = rng.uniform(5.5, 8.5), rng.uniform(0.8, 1.8)
    return mesh.merge(
        [
            mesh.tube([0, 0, 0], [0, 0, 1.2], (0.10, 0.10), Finish(Material.METAL, GREY, rng.uniform(0, 99))),
            mesh.tube([0, 0, 1.2], [0, 0, height], (0.07, 0.05), Finish(Material.METAL, GREY, rng.uniform(0, 99))),
            mesh.tube([0, 0, height], [0, -reach, height + 0.25], (0.04, 0.04), Finish(Material.METAL, GREY), sides=6),
            mesh.box([-0.12, -reach - 0.5, height + 0.18], [0.12, -reach, height + 0.32], Finish(Material.PLAIN, GREY)),
        ]
    )


def sign(rng: np.random.Generator) -> Mesh:
    """Build a road sign that faces against the traffic (-x)."""
    height = rng.uniform(2.1, 2.6)
    look = int(rng.integers(4))
    sides = (3, 20, 4, 20)[look]
    plate = mesh.disc([-0.045, 0, height + 0.32], 0, 0.34, Finish(Material.SIGN, [0.7, 0.7, 0.7], look + 0.5), sides)
    back = mesh.disc([-0.035, 0, height + 0.32], 0, 0.34, Finish(Material.METAL, GREY, 0.0), sides)
    pole = mesh.tube([0, 0, 0], [0, 0, height + 0.7], (0.035, 0.035), Finish(Material.METAL, [0.3, 0.31, 0.32], 5.0))
    return mesh.merge([plate, back, pole])


def bollard(rng: np.random.Generator) -> Mesh:
    """Build a bollard."""
    return mesh.tube(
        [0, 0, 0], [0, 0, 0.95], (0.06, 0.05), Finish(Material.PLAIN, [0.12, 0.10, 0.09], rng.uniform(0, 99))
    )


def bin_(rng: np.random.Generator) -> Mesh:
    """Build a wheeled bin."""
    tint = [[0.03, 0.05, 0.03], [0.05, 0.05, 0.055], [0.25, 0.2, 0.03], [0.04, 0.05, 0.12]][rng.integers(4)]
    return mesh.merge(
        [
            mesh.box([-0.29, -0.33, 0.06], [0.29, 0.33, 1.0], Finish(Material.PLAIN, tint, rng.uniform(0, 99))),
            mesh.box([-0.31, -0.36, 1.0], [0.31, 0.36, 1.08], Finish(Material.PLAIN, tint, rng.uniform(0, 99))),
        ]
    )


def wall(rng: np.random.Generator, length_m: float) -> Mesh:
    """Build a garden wall from x = 0 to its length, facing -y."""
    height = rng.uniform(0.6, 2.0)
    material = [Material.BRICK, Material.PLASTER][rng.integers(2)]
    tint = [[0.36, 0.19, 0.13], [0.45, 0.43, 0.40]][rng.integers(2)]
    cap = mesh.bar([0, -0.05, height], [length_m, 0.3, height + 0.07], Finish(Material.KERB, [0.35, 0.33, 0.31]))
    return mesh.merge([mesh.bar([0, 0, 0], [length_m, 0.25, height], Finish(material, tint, rng.uniform(0, 999))), cap])


def fence(rng: np.random.Generator, length_m: float) -> Mesh:
    """Build a picket fence from x = 0 to its length; one sees and measures through it."""
    tint = np.array([[0.25, 0.17, 0.10], [0.5, 0.5, 0.48], [0.05, 0.09, 0.06]][rng.integers(3)])
    step, height = rng.uniform(0.13, 0.2), rng.uniform(0.8, 1.4)
    x = np.arange(0, length_m, step)
    tops = height + rng.normal(0, 0.01, len(x))
    wide = 0.5 * step
    pickets = [[(a, 0, 0), (a + wide, 0, 0), (a + wide, 0, t), (a, 0, t)] for a, t in zip(x, tops, strict=True)]
    rails = [
        mesh.bar([0, 0.02, z], [length_m, 0.06, z + 0.07], Finish(Material.PLAIN, tint)) for z in (0.2, height - 0.25)
    ]
    return mesh.merge([mesh.quads(pickets, Finish(Material.PLAIN, tint, rng.uniform(0, 99, len(x)))), *rails])
