"""Cars: a curved body, a glass house on it, wheels, lamps, plates.

A car stands at the origin with x forward, y left, z up; its wheels touch z = 0.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

PAINTS = np.array(
    [
        [0.012, 0.012, 0.013], [0.02, 0.02, 0.022], [0.30, 0.31, 0.32], [0.42, 0.42, 0.42], [0.10, 0.105, 0.115],
        [0.015, 0.022, 0.05], [0.16, 0.015, 0.015], [0.55, 0.55, 0.53], [0.02, 0.04, 0.03], [0.15, 0.15, 0.16],
        [0.22, 0.19, 0.15], [0.03, 0.05, 0.12], [0.05, 0.05, 0.055], [0.24, 0.25, 0.27],
    ]
)  # fmt: skip
BLACK_TINT = [0.012, 0.012, 0.012]


@dataclass(frozen=True)
class Shape:
    """A kind of car; lengths in metres, places along it as shares of its length from the rear bumper."""

    length_m: float
    width_m: float
    height_m: float
    belt: float
    """Height of the windows' lower edge as a share of the height."""
    hood: float
    """Height of the hood's front edge as a share of the belt's."""
    boot: float
    """Height of the rear end's upper edge as a share of the belt's."""
    foot: tuple[float, float]
    """Where the rear and the front screen begin."""
    roof: tuple[float, float]
    """Where the rear and the front screen end."""


SHAPES = {
    "saloon": Shape(4.55, 1.79, 1.43, 0.63, 0.80, 0.97, (0.13, 0.74), (0.29, 0.57)),
    "hatch": Shape(3.95, 1.70, 1.47, 0.61, 0.80, 1.0, (0.015, 0.79), (0.13, 0.58)),
    "estate": Shape(4.60, 1.80, 1.47, 0.62, 0.79, 1.0, (0.015, 0.745), (0.09, 0.57)),
    "van": Shape(4.90, 1.93, 1.95, 0.56, 0.80, 1.0, (0.01, 0.87), (0.035, 0.70)),
    "jeep": Shape(4.45, 1.84, 1.74, 0.60, 0.90, 1.0, (0.012, 0.74), (0.05, 0.62)),
}
# Cross-section of the body: height as a share from underside to top, half width as a share.
SECTION = np.array(
    [
        [0.0, 0.86], [0.06, 0.93], [0.2, 0.975], [0.4, 1.0], [0.62, 0.995], [0.8, 0.965], [0.91, 0.915], [0.98, 0.83],
        [1.01, 0.68], [1.03, 0.35], [1.035, 0.0],
    ]
)  # fmt: skip


def car(rng: np.random.Generator) -> Mesh:
    """Build a car of a drawn kind, size and paint."""
    kind = str(rng.choice(list(SHAPES), p=[0.22, 0.35, 0.23, 0.1, 0.1]))
    s = SHAPES[kind]
    stretch = rng.uniform(0.94, 1.06)
    shape = Shape(
        s.length_m * stretch, s.width_m * rng.uniform(0.97, 1.03), s.height_m * rng.uniform(0.97, 1.04),
        s.belt * rng.uniform(0.98, 1.03), s.hood * rng.uniform(0.95, 1.04), s.boot, s.foot, s.roof,
    )  # fmt: skip
    paint = PAINTS[rng.integers(len(PAINTS))] * rng.uniform(0.8, 1.2)
    key = float(rng.uniform(0, 1000))
    return mesh.merge(
        [
            *_body(shape, paint, key),
            *_glass_house(shape, paint, key),
            *_wheels(shape, rng),
            *_details(shape, key, rng),
        ]
    )


def _body(shape: Shape, paint: npt.ArrayLike, key: float) -> list[Mesh]:
    """Loft the lower body over stations along the car; its uv is (share of the length, height)."""
    share = np.array([0, 0.006, 0.02, 0.05, 0.12, 0.25, 0.4, 0.55, 0.68, 0.78, 0.88, 0.94, 0.975, 0.992, 1.0])
    belt = shape.belt * shape.height_m
    foot = shape.foot[1]
    top = belt * np.interp(
        share,
        [0, 0.02, shape.foot[0] + 0.02, 0.4, foot, 0.5 * (1 + foot), 0.97, 1.0],
        [
            0.80 * shape.boot,
            0.97 * shape.boot,
            1,
            1,
            0.985,
            0.5 + 0.5 * shape.hood,
            shape.hood * 0.93,
            shape.hood * 0.74,
        ],
    )
    low = np.interp(share, [0, 0.03, 0.15, 0.85, 0.97, 1], [0.34, 0.25, 0.21, 0.21, 0.23, 0.32])
    half = (
        0.5
        * shape.width_m
        * np.interp(share, [0, 0.01, 0.04, 0.2, 0.8, 0.93, 0.985, 1], [0.84, 0.9, 0.95, 1, 1, 0.95, 0.86, 0.76])
    )
    z = low[:, None] + SECTION[:, 0] * (top - low)[:, None]
    y = half[:, None] * SECTION[:, 1]
    x = np.broadcast_to(((share - 0.5) * shape.length_m)[:, None], z.shape)
    left = np.stack([x, y, z], axis=-1)
    rings = np.concatenate([left, left[:, -2::-1] * [1, -1, 1]], axis=1)
    uv = np.stack([np.broadcast_to(share[:, None], rings.shape[:2]), rings[..., 2]], axis=-1)
    shell = mesh.loft(rings, Finish(Material.PAINT, paint, key), uv, smooth=True)
    count = rings.shape[1]
    ends = [[ring[i], ring[i + 1], ring[count - 2 - i], ring[count - 1 - i]] for ring in (rings[0], rings[-1])
            for i in range(count // 2)]  # fmt: skip
    floor = np.stack([rings[:-1, 0], rings[1:, 0], rings[1:, -1], rings[:-1, -1]], axis=1)
    end_caps = mesh.quads(ends, Finish(Material.PAINT, paint, key), np.full((4, 2), 0.9))
    return [shell, end_caps, mesh.quads(floor, Finish(Material.RUBBER, BLACK_TINT))]


def _glass_house(shape: Shape, paint: npt.ArrayLike, key: float) -> list[Mesh]:
    """Build the windows all around, uv (-1 rear .. 1 front, 0 belt .. 1 roof), and a domed roof."""
    angle = np.linspace(0, 2 * np.pi, 49)
    c, s = np.cos(angle), np.sin(angle)
    round_x, round_y = (np.sign(f) * np.abs(f) ** 0.36 for f in (c, s))
    v = np.linspace(0, 1, 6)
    lean = v**1.15
    rear, front = ((shape.foot[i] + (shape.roof[i] - shape.foot[i]) * lean - 0.5) * shape.length_m for i in (0, 1))
    half = 0.5 * shape.width_m * (0.90 - 0.20 * v**1.3)
    z = shape.belt * shape.height_m - 0.02 + v * (0.955 - shape.belt) * shape.height_m
    rings = _outlines(rear, front, half, z, round_x, round_y)
    uv = np.stack(np.broadcast_arrays(round_x[None], v[:, None]), axis=-1)
    cap = np.array([1.0, 0.93, 0.75, 0.4, 0.0])
    middle, reach = 0.5 * (rear[-1] + front[-1]), 0.5 * (front[-1] - rear[-1])
    dome = z[-1] + (shape.height_m - z[-1]) * np.sqrt(1 - cap**2) ** 0.7
    roof = _outlines(middle - reach * cap, middle + reach * cap, half[-1] * cap, dome, round_x, round_y)
    return [
        mesh.loft(rings, Finish(Material.CAR_GLASS, paint, key), uv.astype(np.float32), smooth=True),
        mesh.loft(
            roof, Finish(Material.PAINT, paint, key), np.full((*roof.shape[:2], 2), 0.95, np.float32), smooth=True
        ),
    ]


def _outlines(
    rear: npt.NDArray[np.floating], front: npt.NDArray[np.floating], half: npt.NDArray[np.floating],
    z: npt.NDArray[np.floating], round_x: npt.NDArray[np.floating], round_y: npt.NDArray[np.floating],
) -> npt.NDArray[np.floating]:  # fmt: skip
    """Return rounded outlines seen from above, (levels, points, 3)."""
    x = 0.5 * (rear + front)[:, None] + 0.5 * (front - rear)[:, None] * round_x
    y = half[:, None] * round_y
    return np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1)


def _wheels(shape: Shape, rng: np.random.Generator) -> list[Mesh]:
    """Build tyres and rims, and the dark of the arches around them."""
    radius = float(rng.uniform(0.29, 0.34)) * (1.12 if shape.height_m > 1.65 else 1.0)
    rim = np.full(3, rng.uniform(0.22, 0.5))
    parts = []
    for x in (-0.305 * shape.length_m, 0.31 * shape.length_m):
        for side in (1, -1):
            face = side * 0.5 * shape.width_m
            arch = mesh.disc([x, face * 1.003, radius], 1, radius * 1.15, Finish(Material.RUBBER, BLACK_TINT), sides=20)
            arch.corners[..., 2] = np.maximum(arch.corners[..., 2], 0.2)
            tyre = [x, face - side * 0.2, radius], [x, face + side * 0.012, radius]
            parts += [
                arch,
                mesh.tube(*tyre, (radius, radius), Finish(Material.RUBBER, [0.022] * 3), sides=20),
                mesh.disc([x, face + side * 0.012, radius], 1, radius, Finish(Material.RUBBER, [0.02] * 3), sides=20),
                mesh.disc(
                    [x, face + side * 0.018, radius], 1, 0.66 * radius, Finish(Material.RIM, rim, rng.uniform(0, 9)), 18
                ),
            ]
    return parts


def _details(shape: Shape, key: float, rng: np.random.Generator) -> list[Mesh]:
    """Add lamps, plates, a grille, bumper strips and mirrors."""
    front, rear, half = 0.5 * shape.length_m, -0.5 * shape.length_m, 0.5 * shape.width_m
    belt = shape.belt * shape.height_m
    hood = belt * shape.hood
    parts = []
    for side in (1, -1):
        head = sorted((side * 0.44 * half, side * 0.79 * half))
        tail = sorted((side * 0.62 * half, side * 0.86 * half))
        mirror = sorted((side * 0.76 * half, side * 1.09 * half))
        x = (shape.foot[1] - 0.545) * shape.length_m
        lamp = [front - 0.2, head[0], hood * 0.60], [front + 0.008, head[1], hood * 0.75]
        light = [rear - 0.008, tail[0], belt * 0.62], [rear + 0.12, tail[1], belt * 0.84]
        parts += [
            mesh.box(*lamp, Finish(Material.LAMP, [0.6] * 3, key)),
            mesh.box(*light, Finish(Material.LAMP, [0.30, 0.012, 0.012], key)),
            mesh.box(
                [x, mirror[0], belt + 0.01], [x + 0.08, mirror[1], belt + 0.13], Finish(Material.PLAIN, BLACK_TINT, key)
            ),
        ]
    for x, z in ((front + 0.012, 0.42), (rear - 0.012, belt * 0.60)):
        plate = [x, -0.26, z], [x, 0.26, z], [x, 0.26, z + 0.11], [x, -0.26, z + 0.11]
        parts.append(
            mesh.quads([plate], Finish(Material.PLATE, [0.62, 0.62, 0.6], rng.uniform(0, 999)), mesh.UNIT_PANE)
        )
    strips = [
        [[front - 0.1, -0.40 * half, hood * 0.60], [front + 0.006, 0.40 * half, hood * 0.73]],
        [[front - 0.12, -0.66 * half, 0.33], [front + 0.006, 0.66 * half, 0.39]],
        [[rear - 0.006, -0.7 * half, 0.36], [rear + 0.1, 0.7 * half, 0.43]],
    ]
    return [*parts, mesh.boxes(strips, Finish(Material.RUBBER, BLACK_TINT))]
