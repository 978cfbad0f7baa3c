"""Houses: façades with recessed windows and doors, side walls, roofs, chimneys, balconies.

A house is built for the left side of the street in its own frame: x along the street from 0 to its width, y away from
the street with the façade at 0, z up from the pavement.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

Values = npt.NDArray[np.floating]
PLASTER_TINTS = np.array(
    [
        [0.62, 0.56, 0.44], [0.66, 0.63, 0.56], [0.50, 0.47, 0.42], [0.60, 0.48, 0.30], [0.52, 0.33, 0.20],
        [0.44, 0.46, 0.48], [0.58, 0.52, 0.47], [0.40, 0.30, 0.24], [0.30, 0.36, 0.44], [0.70, 0.66, 0.50],
        [0.36, 0.42, 0.34], [0.56, 0.40, 0.33],
    ]
)  # fmt: skip
BRICK_TINTS = np.array([[0.34, 0.16, 0.11], [0.40, 0.22, 0.14], [0.28, 0.15, 0.12], [0.45, 0.34, 0.24]])
ROOF_TINTS = np.array([[0.30, 0.13, 0.08], [0.20, 0.12, 0.10], [0.11, 0.11, 0.12], [0.26, 0.17, 0.12]])
TRIM_TINTS = np.array([[0.72, 0.72, 0.70], [0.55, 0.52, 0.48], [0.30, 0.24, 0.20], [0.75, 0.74, 0.72]])
DOOR_TINTS = np.array([[0.16, 0.09, 0.05], [0.06, 0.12, 0.09], [0.10, 0.12, 0.20], [0.35, 0.33, 0.30]])


@dataclass(frozen=True)
class Style:
    """What the windows and walls of one house have in common."""

    wall: int
    wall_tint: Values
    base_tint: Values
    trim_tint: Values
    floor_m: float
    base_m: float
    window_m: tuple[float, float]
    """Width and height."""
    recess_m: float
    shop: bool
    trim_m: float
    """Width of the frames on the wall around windows; 0 = none."""
    bands: bool
    """Whether a moulding runs along under each floor."""
    shutters: Values | None
    """Colour of the shutters, None where there are none."""
    key: float


class Openings(NamedTuple):
    """The windows and doors of one floor, one each `pitch_m` of the façade; arrays are (n,), metres."""

    middle: Values
    """Along the façade."""
    half: Values
    """Half the width."""
    sill: Values
    """Height of the lower edge."""
    head: Values
    """Height of the upper edge."""
    pitch_m: float

    def pick(self, which: npt.NDArray[np.bool_]) -> "Openings":
        """Return some of the openings."""
        return Openings(self.middle[which], self.half[which], self.sill[which], self.head[which], self.pitch_m)


def draw_style(rng: np.random.Generator) -> Style:
    """Draw the look of a house."""
    brick = rng.random() < 0.25
    tints = BRICK_TINTS if brick else PLASTER_TINTS
    tint = tints[rng.integers(len(tints))] * rng.uniform(0.6, 1.05) * rng.uniform(0.95, 1.05, 3)
    grey = rng.uniform(0.25, 0.8) * (0.3 if brick else 1.0)
    tint = (1 - grey) * tint + grey * tint.mean()
    return Style(
        wall=Material.BRICK if brick else Material.PLASTER,
        wall_tint=tint,
        base_tint=tint * rng.uniform(0.45, 0.8) if rng.random() < 0.6 else np.full(3, rng.uniform(0.2, 0.4)),
        trim_tint=TRIM_TINTS[rng.integers(len(TRIM_TINTS))],
        floor_m=rng.uniform(2.7, 3.4),
        base_m=rng.uniform(0.4, 1.0),
        window_m=(rng.uniform(0.9, 1.6), rng.uniform(1.2, 1.75)),
        recess_m=rng.uniform(0.08, 0.24),
        shop=bool(rng.random() < 0.25),
        trim_m=float(rng.choice([0.0, rng.uniform(0.07, 0.16)])),
        bands=bool(rng.random() < 0.4),
        shutters=DOOR_TINTS[rng.integers(len(DOOR_TINTS))] if rng.random() < 0.15 else None,
        key=rng.uniform(0, 1000),
    )


def house(rng: np.random.Generator, width_m: float, floors: int, depth_m: float = 10.0) -> Mesh:
    """Build one house of a width and a number of floors."""
    style = draw_style(rng)
    eaves = style.base_m + floors * style.floor_m
    parts = [facade(rng, style, width_m, floors), *_shell(rng, style, width_m, depth_m, eaves)]
    if rng.random() < 0.75:
        parts += _gable_roof(rng, style, width_m, depth_m, eaves)
    else:
        parts.append(
            mesh.bar([0, -0.1, eaves], [width_m, depth_m, eaves + 0.5], Finish(style.wall, style.wall_tint, style.key))
        )
    if floors > 2 and rng.random() < 0.35:
        parts += _balconies(rng, style, width_m, floors)
    if rng.random() < 0.7:
        x = rng.choice([0.06, width_m - 0.14])
        parts.append(
            mesh.tube([x, -0.07, 0], [x, -0.07, eaves], (0.05, 0.05), Finish(Material.PLAIN, [0.3, 0.3, 0.3]), sides=6)
        )
    return mesh.merge(parts)


def facade(rng: np.random.Generator, style: Style, width_m: float, floors: int) -> Mesh:
    """Build the front: wall cells around openings, and in each opening a recessed pane with reveals and a sill."""
    count = max(1, int(width_m / rng.uniform(1.9, 3.0)))
    pitch = width_m / count
    opening = min(style.window_m[0], 0.72 * pitch)
    middles = (np.arange(count) + 0.5) * pitch
    door = int(rng.integers(count))
    parts = []
    for floor in range(floors):
        low = style.base_m + floor * style.floor_m if floor else 0.0
        top = style.base_m + (floor + 1) * style.floor_m
        sill = np.full(count, style.base_m + floor * style.floor_m + 0.85)
        head = np.minimum(sill + style.window_m[1], top - 0.25)
        half = np.full(count, 0.5 * opening)
        is_door = np.zeros(count, bool)
        if floor == 0:
            is_door[door] = True
            sill[door], head[door] = 0.1, style.base_m + 2.1
            if style.shop:
                sill[:], head[:], half[:] = 0.4, top - 0.5, 0.44 * pitch
        openings = Openings(middles, half, sill, head, pitch)
        parts.append(_wall_around(style, (low, top), openings))
        parts.append(_fill(rng, style, openings, is_door))
        if floor or not style.shop:
            parts += _trim(style, openings.pick(~is_door))
        if floor and style.bands:
            parts.append(
                mesh.bar(
                    [0, -0.06, low - 0.09], [width_m, 0, low + 0.09], Finish(Material.PLAIN, style.trim_tint * 0.85)
                )
            )
    if style.shop:
        parts += _shop_front(rng, style, width_m)
    band = style.base_m if not style.shop else 0.4
    parts.append(
        mesh.bar([0, -0.04, 0], [width_m, 0.0, band], Finish(Material.PLASTER, style.base_tint, style.key + 5))
    )
    return mesh.merge(parts)


def _wall_around(style: Style, z: tuple[float, float], openings: Openings) -> Mesh:
    """Build the wall of one floor, between two heights, around its openings."""
    cells = []
    for x, h, low, high in zip(*openings[:4], strict=True):
        left, right = x - 0.5 * openings.pitch_m, x + 0.5 * openings.pitch_m
        cells += [(left, x - h, z[0], z[1]), (x + h, right, z[0], z[1])]
        cells += [(x - h, x + h, z[0], low), (x - h, x + h, high, z[1])]
    return mesh.quads([_upright(*cell, 0.0) for cell in cells], Finish(style.wall, style.wall_tint, style.key))


def _upright(x0: float, x1: float, z0: float, z1: float, y: float) -> list[tuple[float, float, float]]:
    return [(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1)]


def _fill(rng: np.random.Generator, style: Style, openings: Openings, is_door: npt.NDArray[np.bool_]) -> Mesh:
    """Put a recessed pane or door, its reveals and a sill into each opening."""
    parts, y = [], style.recess_m
    door_tint = DOOR_TINTS[rng.integers(len(DOOR_TINTS))]
    reveals = []
    for x, h, low, high, door in zip(*openings[:4], is_door, strict=True):
        pane = _upright(x - h, x + h, low, high, y)
        material, tint = (Material.DOOR, door_tint) if door else (Material.GLASS, style.trim_tint)
        parts.append(mesh.quads([pane], Finish(material, tint, rng.uniform(0, 1000)), mesh.UNIT_PANE))
        front = _upright(x - h, x + h, low, high, 0.0)
        reveals += [[front[i], front[(i + 1) % 4], pane[(i + 1) % 4], pane[i]] for i in range(4)]
        if not door:
            ledge = [x - h - 0.06, -0.09, low - 0.07], [x + h + 0.06, 0.02, low]
            parts.append(mesh.box(*ledge, Finish(Material.PLAIN, style.trim_tint * 0.8, style.key)))
    parts.append(mesh.quads(reveals, Finish(Material.PLAIN, style.wall_tint * 0.9, style.key)))
    return mesh.merge(parts)


def _trim(style: Style, windows: Openings) -> list[Mesh]:
    """Put frames or shutters on the wall around windows."""
    middle, half, sill, head, pitch_m = windows
    left, right, flat = middle - half, middle + half, np.zeros(len(middle))
    parts = []
    if style.shutters is not None and 2.2 * half[0] < 0.5 * pitch_m:
        wide = np.minimum(half, 0.25 * pitch_m)
        ends = [_box_ends(a, b, flat - 0.05, flat, sill, head) for a, b in ((left - wide, left), (right, right + wide))]
        parts.append(mesh.boxes(np.concatenate(ends), Finish(Material.PLAIN, style.shutters, style.key)))
    elif style.trim_m and len(middle):
        w = style.trim_m
        ends = [
            _box_ends(left - w, left, flat - 0.03, flat, sill, head),
            _box_ends(right, right + w, flat - 0.03, flat, sill, head),
            _box_ends(left - w, right + w, flat - 0.04, flat, head, head + w),
        ]
        parts.append(mesh.boxes(np.concatenate(ends), Finish(Material.PLAIN, style.trim_tint * 0.9, style.key)))
    return parts


def _box_ends(x0: Values, x1: Values, y0: Values, y1: Values, z0: Values, z1: Values) -> Values:
    return np.stack([np.stack([x0, y0, z0], axis=-1), np.stack([x1, y1, z1], axis=-1)], axis=1)


def _shop_front(rng: np.random.Generator, style: Style, width_m: float) -> list[Mesh]:
    """Put a sign board over the shop windows, and perhaps an awning."""
    top = style.base_m + style.floor_m
    tint = DOOR_TINTS[rng.integers(len(DOOR_TINTS))] * rng.uniform(0.5, 2.0) + 0.02
    parts = [
        mesh.bar(
            [0.3, -0.1, top - 0.45], [width_m - 0.3, 0, top + 0.1], Finish(Material.SHOP, tint, rng.uniform(0, 99))
        )
    ]
    if rng.random() < 0.5:
        cloth = np.array([[0.3, 0.05, 0.04], [0.05, 0.12, 0.08], [0.45, 0.42, 0.36], [0.06, 0.08, 0.2]])[
            rng.integers(4)
        ]
        awning = [
            (0.4, -0.05, top - 0.45),
            (width_m - 0.4, -0.05, top - 0.45),
            (width_m - 0.4, -1.1, top - 0.95),
            (0.4, -1.1, top - 0.95),
        ]
        parts.append(mesh.quads([awning], Finish(Material.CLOTH, cloth, rng.uniform(0, 99))))
    return parts


def _shell(rng: np.random.Generator, style: Style, width_m: float, depth_m: float, eaves: float) -> list[Mesh]:
    """Build the side and back walls, the sides perhaps with windows."""
    side = [[(x, 0, 0), (x, depth_m, 0), (x, depth_m, eaves), (x, 0, eaves)] for x in (0.0, width_m)]
    back = _upright(0.0, width_m, 0.0, eaves, depth_m)
    parts = [mesh.quads([*side, back], Finish(style.wall, style.wall_tint, style.key + 11))]
    panes = []
    for y in np.arange(2.2, depth_m - 2, 3.3):
        for z in np.arange(style.base_m + 0.9, eaves - 1.6, style.floor_m):
            low, high = z, z + style.window_m[1]
            for x in (-0.015, width_m + 0.015):
                panes.append([(x, y - 0.5, low), (x, y + 0.5, low), (x, y + 0.5, high), (x, y - 0.5, high)])
    if panes and rng.random() < 0.6:
        keys = rng.uniform(0, 1000, len(panes))
        parts.append(mesh.quads(panes, Finish(Material.GLASS, style.trim_tint, keys), mesh.UNIT_PANE))
    return parts


def _gable_roof(rng: np.random.Generator, style: Style, width_m: float, depth_m: float, eaves: float) -> list[Mesh]:
    """Build a roof with its ridge along the street, gables, and perhaps a chimney and dormers."""
    tint = ROOF_TINTS[rng.integers(len(ROOF_TINTS))] * rng.uniform(0.8, 1.2)
    rise = 0.5 * depth_m * rng.uniform(0.55, 1.0)
    hang, y = 0.35, 0.5 * depth_m
    low = eaves - hang * rise / y
    ridge = eaves + rise
    front = [(0.0, -hang, low), (width_m, -hang, low), (width_m, y, ridge), (0.0, y, ridge)]
    rear = [(x, depth_m - v, z) for x, v, z in front]
    slope = np.hypot(rise, y)
    uv = [(0, 0), (width_m, 0), (width_m, slope), (0, slope)]
    gables = [[(x, 0.0, eaves), (x, depth_m, eaves), (x, y, ridge), (x, y, ridge)] for x in (0.0, width_m)]
    parts = [
        mesh.quads([front, rear], Finish(Material.ROOF, tint, style.key), uv),
        mesh.quads(gables, Finish(style.wall, style.wall_tint, style.key)),
        mesh.bar(
            [0, -hang - 0.06, low - 0.12], [width_m, -hang + 0.06, low], Finish(Material.PLAIN, [0.25, 0.24, 0.23])
        ),
    ]
    if rng.random() < 0.8:
        x = rng.uniform(1, width_m - 1)
        parts.append(
            mesh.box([x - 0.35, y, ridge - 1], [x + 0.35, y + 0.7, ridge + 0.9], Finish(Material.BRICK, BRICK_TINTS[0]))
        )
    if rng.random() < 0.6:
        for x in np.arange(1.5, width_m - 1.4, 3.4):
            parts += _dormer(rng, style, tint, float(x), eaves, rise / y)
    return parts


def _dormer(rng: np.random.Generator, style: Style, tint: Values, x: float, eaves: float, pitch: float) -> list[Mesh]:
    y, half, height = 0.7, 0.7, 1.5
    low = eaves + y * pitch
    back = y + height / pitch
    front = [x - half, y, low - 0.3], [x + half, back, low + height]
    lid = [x - half - 0.15, y - 0.2, low + height], [x + half + 0.15, back, low + height + 0.12]
    window = _upright(x - half + 0.12, x + half - 0.12, low + 0.25, low + height - 0.1, y - 0.02)
    return [
        mesh.box(*front, Finish(Material.PLASTER, style.wall_tint, style.key)),
        mesh.box(*lid, Finish(Material.ROOF, tint, style.key)),
        mesh.quads([window], Finish(Material.GLASS, style.trim_tint, rng.uniform(0, 1000)), mesh.UNIT_PANE),
    ]


def _balconies(rng: np.random.Generator, style: Style, width_m: float, floors: int) -> list[Mesh]:
    x, half = rng.uniform(2, max(2.1, width_m - 2)), 1.4
    parts = []
    for floor in range(1, floors):
        z = style.base_m + floor * style.floor_m
        parts.append(
            mesh.box([x - half, -1.0, z - 0.15], [x + half, 0.0, z], Finish(Material.PLASTER, style.base_tint))
        )
        parts.append(
            mesh.box([x - half, -1.0, z + 0.1], [x + half, -0.95, z + 1.0], Finish(Material.METAL, style.trim_tint))
        )
    return parts
