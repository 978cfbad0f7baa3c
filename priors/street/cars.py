"""Cars: a lofted body, a cabin with glass on all sides, wheels, lamps, plates.

A car stands at the origin with x forward, y left, z up; its wheels touch z = 0.
"""

import numpy as np

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Mesh

PAINTS = np.array(
    [
        [0.02, 0.02, 0.022], [0.05, 0.05, 0.055], [0.30, 0.31, 0.32], [0.55, 0.55, 0.55], [0.12, 0.13, 0.15],
        [0.03, 0.05, 0.12], [0.28, 0.03, 0.03], [0.65, 0.65, 0.62], [0.06, 0.10, 0.08], [0.20, 0.20, 0.22],
        [0.35, 0.30, 0.22], [0.05, 0.09, 0.20],
    ]
)  # fmt: skip
# Share of the length from the rear bumper: belt height, roof's front and rear, foot of the front and rear screens.
SHAPES = {
    "saloon": (4.5, 1.78, 1.44, 0.27, 0.57, 0.13, 0.70),
    "hatch": (4.0, 1.74, 1.48, 0.12, 0.58, 0.02, 0.73),
    "estate": (4.6, 1.80, 1.48, 0.09, 0.58, 0.01, 0.71),
    "van": (4.9, 1.95, 1.95, 0.05, 0.66, 0.01, 0.82),
    "jeep": (4.5, 1.85, 1.80, 0.06, 0.62, 0.01, 0.68),
}
"""Length, width, height (m); then along the length: roof's rear and front end, foot of rear and front screen."""


def car(rng: np.random.Generator) -> Mesh:
    """Build a car of a drawn kind, size and paint."""
    kind = rng.choice(list(SHAPES), p=[0.25, 0.32, 0.23, 0.1, 0.1])
    length, width, height, roof_rear, roof_front, foot_rear, foot_front = SHAPES[kind]
    length, width, height = (
        length * rng.uniform(0.93, 1.05),
        width * rng.uniform(0.97, 1.03),
        height * rng.uniform(0.97, 1.04),
    )
    paint = PAINTS[rng.integers(len(PAINTS))] * rng.uniform(0.8, 1.2)
    key = rng.uniform(0, 1000)
    belt = height * (0.62 if kind != "van" else 0.55)
    hood = belt * rng.uniform(0.90, 0.97)
    x = lambda share: (share - 0.5) * length  # noqa: E731
    stations = [
        (x(0.0), 0.88, 0.30), (x(0.03), 0.97, 0.24), (x(0.2), 1.0, 0.20), (x(0.5), 1.0, 0.18),
        (x(0.78), 1.0, 0.20), (x(0.94), 0.95, 0.24), (x(1.0), 0.80, 0.32),
    ]  # fmt: skip
    tops = [belt * 0.86, belt * 0.97, belt, belt, hood, hood * 0.86, hood * 0.66]
    parts = [
        _body(stations, tops, 0.5 * width, paint, key),
        _cabin(width, belt, height, (x(roof_rear), x(roof_front)), (x(foot_rear), x(foot_front)), paint, key),
        *_wheels(length, width, rng),
        *_details(length, width, belt, hood, key, rng),
    ]
    return mesh.merge(parts)


def _body(
    stations: list[tuple[float, float, float]], tops: list[float], half: float, paint: mesh.npt.ArrayLike, key: float
) -> Mesh:
    """Loft the lower body; a station is (x, share of the width, height of the underside)."""
    rings = []
    for (x, share, low), top in zip(stations, tops, strict=True):
        w = half * share
        side = [(0.93 * w, low), (1.0 * w, low + 0.35 * (top - low)), (0.99 * w, low + 0.7 * (top - low)), (0.93 * w, top - 0.05),
                (0.8 * w, top), (0.0, top + 0.03)]  # fmt: skip
        outline = [(y, z) for y, z in side] + [(-y, z) for y, z in side[-2::-1]]
        rings.append([(x, y, z) for y, z in outline])
    shell = mesh.loft(rings, Material.PAINT, paint, key)
    ends = []
    for ring in (rings[0], rings[-1]):
        n = len(ring)
        ends += [[ring[i], ring[i + 1], ring[n - 2 - i], ring[n - 1 - i]] for i in range(n // 2)]
    floor = [[rings[i][0], rings[i + 1][0], rings[i + 1][-1], rings[i][-1]] for i in range(len(rings) - 1)]
    return mesh.merge(
        [shell, mesh.quads(ends, Material.PAINT, paint, key), mesh.quads(floor, Material.RUBBER, [0.02] * 3)]
    )


def _cabin(
    width: float, belt: float, height: float, roof: tuple[float, float], foot: tuple[float, float],
    paint: mesh.npt.ArrayLike, key: float,
) -> Mesh:  # fmt: skip
    """Build screens and side windows with pillars between them, and a gently domed roof."""
    low_w, top_w, z0, z1 = 0.5 * width * 0.92, 0.5 * width * 0.68, belt - 0.03, height - 0.06
    parts = []
    unit = [(0, 0), (1, 0), (1, 1), (0, 1)]
    rear = [(foot[0], low_w * 0.94, z0), (foot[0], -low_w * 0.94, z0), (roof[0], -top_w, z1), (roof[0], top_w, z1)]
    front = [(foot[1], -low_w * 0.94, z0), (foot[1], low_w * 0.94, z0), (roof[1], top_w, z1), (roof[1], -top_w, z1)]
    parts.append(mesh.quads([rear, front], Material.CAR_GLASS, paint, key, unit))
    for side in (1, -1):
        cuts = np.array([0.0, 0.3, 0.66, 1.0])
        bottom = [(foot[0] + c * (foot[1] - foot[0]), side * low_w, z0) for c in cuts]
        top = [(roof[0] + c * (roof[1] - roof[0]), side * top_w, z1) for c in cuts]
        panes = [[bottom[i], bottom[i + 1], top[i + 1], top[i]] for i in range(3)]
        parts.append(mesh.quads(panes, Material.CAR_GLASS, paint, key, unit))
    crown = height
    rings = [[(x, top_w, z1), (x, 0.7 * top_w, z), (x, -0.7 * top_w, z), (x, -top_w, z1)]
             for x, z in ((roof[0], z1 + 0.02), (roof[0] + 0.25, crown), (roof[1] - 0.4, crown), (roof[1], z1 + 0.02))]  # fmt: skip
    parts.append(mesh.loft(rings, Material.PAINT, paint, key))
    return mesh.merge(parts)


def _wheels(length: float, width: float, rng: np.random.Generator) -> list[Mesh]:
    radius = rng.uniform(0.29, 0.34)
    rim = np.full(3, rng.uniform(0.25, 0.5))
    parts = []
    for x in (-0.30 * length, 0.315 * length):
        for side in (1, -1):
            outer, inner = side * 0.5 * width * 1.0, side * (0.5 * width - 0.22)
            dark = mesh.disc(
                [x, side * (0.5 * width * 1.004), radius], 1, radius * 1.16, Material.RUBBER, [0.008] * 3, sides=16
            )
            parts.append(_only_above(dark))
            parts.append(
                mesh.tube(
                    [x, inner, radius],
                    [x, outer + side * 0.01, radius],
                    (radius, radius),
                    Material.RUBBER,
                    [0.03] * 3,
                    sides=16,
                )
            )
            parts.append(
                mesh.disc([x, outer + side * 0.012, radius], 1, radius, Material.RUBBER, [0.025] * 3, sides=16)
            )
            parts.append(
                mesh.disc([x, outer + side * 0.02, radius], 1, 0.66 * radius, Material.METAL, rim, key=7, sides=14)
            )
    return parts


def _only_above(arch: Mesh) -> Mesh:
    """Cut what would reach below the road off a wheel arch."""
    return mesh.Mesh(
        np.maximum(arch.corners, np.array([-99, -99, 0.18], np.float32)), arch.uv, arch.material, arch.tint, arch.key
    )


def _details(length: float, width: float, belt: float, hood: float, key: float, rng: np.random.Generator) -> list[Mesh]:
    """Add lamps, plates, a grille, a bumper strip and mirrors."""
    front, rear, half = 0.5 * length, -0.5 * length, 0.5 * width
    parts = []
    for side in (1, -1):
        y0, y1 = sorted((side * 0.46 * half, side * 0.80 * half))
        parts.append(
            mesh.box(
                [front - 0.16, y0, hood * 0.56], [front + 0.015, y1, hood * 0.72], Material.LAMP, [0.7, 0.7, 0.7], key
            )
        )
        y0, y1 = sorted((side * 0.60 * half, side * 0.90 * half))
        parts.append(
            mesh.box(
                [rear - 0.015, y0, belt * 0.60], [rear + 0.14, y1, belt * 0.86], Material.LAMP, [0.45, 0.02, 0.02], key
            )
        )
        y0, y1 = sorted((side * 0.94 * half, side * 1.14 * half))
        parts.append(
            mesh.box([0.17 * length, y0, belt], [0.17 * length + 0.1, y1, belt + 0.14], Material.PAINT, [0.03] * 3, key)
        )
    for x, z in ((front + 0.02, 0.42), (rear - 0.02, belt * 0.66)):
        parts.append(
            mesh.box(
                [x - 0.01, -0.26, z], [x + 0.01, 0.26, z + 0.11], Material.LAMP, [0.7, 0.7, 0.68], rng.uniform(0, 999)
            )
        )
    parts.append(
        mesh.box(
            [front - 0.1, -0.4 * half, hood * 0.5],
            [front + 0.012, 0.4 * half, hood * 0.66],
            Material.RUBBER,
            [0.02] * 3,
        )
    )
    parts.append(
        mesh.box([front - 0.12, -0.8 * half, 0.28], [front + 0.012, 0.8 * half, 0.38], Material.RUBBER, [0.04] * 3)
    )
    parts.append(
        mesh.box([rear - 0.012, -0.85 * half, 0.32], [rear + 0.1, 0.85 * half, 0.42], Material.RUBBER, [0.04] * 3)
    )
    return parts
