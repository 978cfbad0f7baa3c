"""Albedo of every material as a function of the place on the surface: aperiodic, many octaves, filtered by footprint.

Every painter takes a Patch, the rays that met one material, and returns linear RGB albedo (n, 3).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.materials import Material
from priors.street.noise import band, fade, hash_, line, octaves

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Patch:
    """Places on surfaces of one material."""

    uv: Floats
    """(n, 2)"""
    key: Floats
    """(n,)"""
    tint: Floats
    """(n, 3)"""
    footprint: Floats
    """(n,) what a pixel covers, metres."""
    config: StreetConfig


def _mottled(patch: Patch, waves: tuple[float, ...], gains: tuple[float, ...], strength: float = 1.0) -> Floats:
    """Return the tint times exp(noise)."""
    field = octaves(patch.uv, patch.key, patch.footprint, waves, gains)
    return patch.tint * np.exp(np.float32(strength) * field)[:, None]


def asphalt(patch: Patch) -> Floats:
    """Paint a worn carriageway with lane marks, tyre tracks, mended places, cracks and covers."""
    s, t = patch.uv[:, 0], patch.uv[:, 1]
    field = octaves(patch.uv, patch.key, patch.footprint, (31.0, 8.1, 1.7, 0.47, 0.13), (0.08, 0.08, 0.06, 0.06, 0.10))
    field += octaves(patch.uv, patch.key, patch.footprint, (0.045, 0.016), (0.24, 0.36))
    along = patch.uv * np.array([0.07, 1.0], np.float32)
    field += octaves(along, patch.key + 2, patch.footprint, (2.1, 0.7, 0.24), (0.05, 0.05, 0.04))
    field -= np.float32(0.05) * np.cos(np.float32(4 * np.pi / patch.config.lane_m) * t)
    cell_s = np.floor(s / 7.3)
    cell_t = np.floor((t + 0.3 * cell_s) / 2.9)
    mended = (hash_(cell_s, cell_t) < 0.09) & (
        np.abs(s / 7.3 - cell_s - 0.5) * 7.3 < 1 + 2.2 * hash_(cell_s, cell_t + 50)
    )
    field += np.where(mended, 0.6 * hash_(cell_s, cell_t + 9) - 0.4, 0)
    cracks = band(patch.uv, 3.1, patch.key, 5) + 0.25 * band(patch.uv, 0.31, patch.key, 6)
    where = band(patch.uv, 9.0, patch.key, 7) > 0.8
    field -= np.where(where, line(cracks, 0.04, patch.footprint * 2), 0)
    field -= 0.9 * line(t - 0.07, 0.012, patch.footprint)  # the seam between the two laid halves
    cover = np.hypot(np.mod(s, 27.0) - 13.5, t - 0.55 * patch.config.lane_m + np.mod(np.floor(s / 27.0) * 1.7, 2.0))
    field -= 0.7 * line(cover, 0.31, patch.footprint) - 0.5 * line(cover, 0.26, patch.footprint)
    albedo = patch.tint * np.exp(field)[:, None]
    paint = np.where(patch.key < 1.0, _marks(patch), 0)
    worn = np.clip(
        0.8 + 0.35 * octaves(patch.uv, patch.key + 3, patch.footprint, (0.6, 0.11, 0.03), (0.5, 0.5, 0.5)), 0, 1
    )
    share = (paint * worn)[:, None]
    return albedo * (1 - share) + np.float32(0.50) * share


def _marks(patch: Patch) -> Floats:
    """Return how much of each place lane marks cover."""
    config, fp = patch.config, patch.footprint
    s, t = patch.uv[:, 0], patch.uv[:, 1]
    dashes = line(np.mod(s, 9.0) - 4.5, 1.5, fp)
    inner = [config.half_road_m - config.lane_m * k for k in range(1, config.lanes)]
    cover = sum((line(t - x, 0.06, fp) * dashes for x in inner), np.zeros_like(s))
    for side, parking in ((1, config.parking_m[0]), (-1, config.parking_m[1])):
        edge = line(t - side * (config.half_road_m - 0.02), 0.06, fp)
        cover = cover + (edge if parking else 0.0)
    return np.clip(cover, 0, 1).astype(np.float32)


def pavement(patch: Patch) -> Floats:
    """Paint slabs with joints, each of its own brightness."""
    size = np.float32(0.5)
    row = np.floor(patch.uv[:, 1] / size)
    along = patch.uv[:, 0] + 0.25 * np.mod(row, 2)
    column = np.floor(along / size)
    tone = 1 + (0.24 * hash_(row, column, np.floor(patch.key)) - 0.12) * fade(0.5, patch.footprint)
    joint = np.maximum(
        line(np.mod(along, size) - 0.5 * size, 0.006, patch.footprint),
        line(np.mod(patch.uv[:, 1], size) - 0.5 * size, 0.006, patch.footprint),
    )
    albedo = _mottled(patch, (11.0, 2.7, 0.6, 0.14, 0.04, 0.014), (0.10, 0.10, 0.07, 0.09, 0.13, 0.18))
    return albedo * (tone * (1 - 0.5 * joint))[:, None]


def kerb(patch: Patch) -> Floats:
    """Paint kerb stones a metre long."""
    joint = line(np.mod(patch.uv[:, 0], 1.0) - 0.5, 0.008, patch.footprint)
    tone = 1 + (0.24 * hash_(np.floor(patch.uv[:, 0] + 0.5), np.floor(patch.key)) - 0.12)
    return _mottled(patch, (3.0, 0.4, 0.08, 0.02), (0.12, 0.1, 0.12, 0.15)) * (tone * (1 - 0.6 * joint))[:, None]


def grass(patch: Patch) -> Floats:
    """Paint lawn and soil."""
    albedo = _mottled(patch, (17.0, 4.0, 0.9, 0.22, 0.06, 0.02), (0.18, 0.2, 0.2, 0.25, 0.35, 0.35))
    dry = np.clip(0.3 * band(patch.uv, 3.7, patch.key, 3) + 0.1, 0, 0.6)[:, None]
    return albedo * (1 + dry * np.array([0.9, 0.35, 0.3], np.float32))


def plaster(patch: Patch) -> Floats:
    """Paint rendered walls: stains that run down, and grain."""
    streaks = patch.uv * np.array([1.0, 0.12], np.float32)
    albedo = _mottled(patch, (5.0, 1.3, 0.33, 0.09, 0.025), (0.05, 0.05, 0.05, 0.06, 0.08))
    return albedo * np.exp(octaves(streaks, patch.key + 1, patch.footprint, (1.9, 0.43), (0.07, 0.05)))[:, None]


def brick(patch: Patch) -> Floats:
    """Paint courses of bricks, each of its own tone, in mortar."""
    width, height = np.float32(0.24), np.float32(0.075)
    row = np.floor(patch.uv[:, 1] / height)
    along = patch.uv[:, 0] / width + 0.5 * np.mod(row, 2)
    column = np.floor(along)
    lot = np.floor(patch.key)
    tone = np.exp((0.5 * hash_(row, column, lot) - 0.25) * fade(0.16, patch.footprint))
    mortar = (
        0.5
        * np.maximum(
            line((np.mod(along, 1) - 0.5) * width, 0.005, patch.footprint),
            line(np.mod(patch.uv[:, 1], height) - 0.5 * height, 0.005, patch.footprint),
        )[:, None]
    )
    albedo = _mottled(patch, (9.0, 2.6, 0.8, 0.05, 0.017), (0.10, 0.09, 0.06, 0.07, 0.09)) * tone[:, None]
    return albedo * (1 - mortar) + np.float32(0.25) * mortar


def roof(patch: Patch) -> Floats:
    """Paint rows of tiles."""
    row, column = np.floor(patch.uv[:, 1] / 0.33), np.floor(patch.uv[:, 0] / 0.25)
    tone = np.exp((0.5 * hash_(row, column, patch.key) - 0.25) * fade(0.4, patch.footprint))
    shade = 1 - 0.35 * np.mod(patch.uv[:, 1] / 0.33, 1) ** 3 * fade(0.4, patch.footprint)
    return _mottled(patch, (5.0, 1.2, 0.3, 0.06), (0.15, 0.12, 0.1, 0.12)) * (tone * shade)[:, None]


def glass(patch: Patch) -> Floats:
    """Paint frames and what one sees behind a window: curtains, blinds or darkness."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    fp = patch.footprint
    kind, drop = hash_(np.floor(patch.key * 7)), 0.15 + 0.85 * hash_(np.floor(patch.key * 13))
    frame = np.maximum(line(np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)), 0.05, fp), line(u - 0.5, 0.025, fp))
    cross = np.where(hash_(np.floor(patch.key * 3)) < 0.4, line(v - 0.68, 0.022, fp), 0)
    frame = np.maximum(frame, cross)[:, None]
    folds = 0.75 + 0.25 * np.sin(u * 40 + 3 * np.sin(v * 3 + patch.key)) * fade(0.15, fp)
    dark = np.full((len(u), 3), 0.012, np.float32)
    curtain = (0.28 * folds)[:, None] * np.array([1.0, 0.97, 0.9], np.float32)
    slats = 0.35 * (0.8 + 0.2 * np.sign(np.sin(v * 130)) * fade(0.07, fp))
    drawn = (np.abs(u - 0.5) > 0.5 - 0.42 * drop) & (kind < 0.5)
    inside = np.where(drawn[:, None], curtain, dark)
    inside = np.where(((kind > 0.72) & (v > 1 - drop))[:, None], slats[:, None], inside)
    return inside * (1 - frame) + patch.tint * frame


def door(patch: Patch) -> Floats:
    """Paint panels and a pane at the top."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    groove = np.maximum(
        line(np.mod(u * 2, 1) - 0.5, 0.40, patch.footprint) * line(np.mod(v * 3, 1) - 0.5, 0.42, patch.footprint), 0
    )
    pane = (v > 0.68) & (v < 0.94) & (np.abs(u - 0.5) < 0.36)
    grain = np.exp(0.15 * band(patch.uv * np.array([1.0, 0.1], np.float32), 0.03, patch.key))
    wood = patch.tint * (grain * (0.75 + 0.35 * groove))[:, None]
    return np.where(pane[:, None], np.float32(0.02), wood)


def paint(patch: Patch) -> Floats:
    """Paint car bodies, uv (share of the length, height): gaps around the doors, a dirty sill."""
    along, up = patch.uv[:, 0], patch.uv[:, 1]
    footprint = patch.footprint / 4
    side = (up > 0.3) & (up < 0.92)
    gaps = sum((line(along - x, 0.0009, footprint) for x in (0.295, 0.475, 0.675)), np.zeros_like(along))
    dirt = np.exp(-np.maximum(up - 0.2, 0) / 0.12)
    dust = 0.02 * band(patch.uv * np.array([4, 1], np.float32), 0.3, patch.key)
    albedo = patch.tint * (1 + dust - 0.75 * gaps * side)[:, None]
    return albedo * (1 - 0.5 * dirt[:, None]) + np.float32(0.05) * 0.5 * dirt[:, None]


def car_glass(patch: Patch) -> Floats:
    """Paint a glass house, uv (-1 rear .. 1 front, 0 belt .. 1 roof): dark panes between painted pillars."""
    along, up = patch.uv[:, 0], patch.uv[:, 1]
    fp = patch.footprint
    lean = along - 0.05 * (up - 0.5)
    pillars = line(np.abs(along) - 0.93, 0.028, fp)
    rubber = np.maximum(line(lean + 0.30, 0.030, fp), line(lean - 0.22, 0.026, fp)) * (np.abs(along) < 0.9)
    frame = np.maximum(line(up, 0.04, fp * 2), line(up - 1, 0.09, fp * 2))
    seats = (np.abs(np.mod(along * 2.4 + 0.2, 1) - 0.5) < 0.2) & (up < 0.55)
    inside = np.where(seats, np.float32(0.022), np.float32(0.008))[:, None] * np.ones(3, np.float32)
    cover = np.maximum(pillars, frame)[:, None]
    return (inside * (1 - rubber[:, None]) + 0.01 * rubber[:, None]) * (1 - cover) + patch.tint * cover


def metal(patch: Patch) -> Floats:
    """Paint poles: streaks and dents."""
    return _mottled(patch, (0.7, 0.12, 0.03), (0.12, 0.10, 0.10))


def rim(patch: Patch) -> Floats:
    """Paint spokes."""
    angle, radius = np.arctan2(patch.uv[:, 1], patch.uv[:, 0]), np.hypot(patch.uv[:, 0], patch.uv[:, 1])
    spokes = 5 + np.floor(np.mod(patch.key, 4))
    gap = (np.cos(angle * spokes) < 0.1) & (radius > 0.25) & (radius < 0.86)
    return patch.tint * np.where(gap, 0.12, 1.0)[:, None]


def plate(patch: Patch) -> Floats:
    """Paint a number plate: a blue end, letters, a black edge."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    cell = np.floor(u * 9)
    stroke = hash_(np.floor(u * 36), np.floor(v * 5), np.floor(patch.key)) < 0.5
    letters = stroke & (np.abs(v - 0.5) < 0.32) & (np.abs(np.mod(u * 9, 1) - 0.5) < 0.38) & (cell > 0) & (cell != 3)
    face = np.where(letters[:, None], np.float32(0.02), patch.tint)
    face = np.where((u < 0.08)[:, None], np.array([0.02, 0.05, 0.3], np.float32), face)
    return face * (1 - 0.9 * line(np.minimum(v, 1 - v), 0.05, patch.footprint))[:, None]


def shop(patch: Patch) -> Floats:
    """Paint a sign board: bold strokes on a ground of one colour."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    letter = np.floor(u / 0.34)
    stroke = hash_(np.floor(u / 0.085), np.floor(v / 0.1), np.floor(patch.key)) < 0.45
    wide = (np.mod(u, 0.34) < 0.27) & (hash_(np.floor(letter / 6), patch.key) < 0.8)
    ink = np.where(patch.tint.mean(axis=1) > 0.2, 0.03, 0.6)[:, None] * np.ones(3, np.float32)
    return np.where((stroke & wide)[:, None], ink, patch.tint)


def cloth(patch: Patch) -> Floats:
    """Paint clothes: folds."""
    return _mottled(patch, (0.35, 0.12, 0.04), (0.15, 0.15, 0.1))


def bark(patch: Patch) -> Floats:
    """Paint furrowed bark."""
    furrows = patch.uv * np.array([1.0, 0.25], np.float32)
    deep = octaves(furrows, patch.key, patch.footprint, (0.09, 0.03), (0.35, 0.3))
    return _mottled(patch, (1.0, 0.25), (0.25, 0.2)) * np.exp(deep)[:, None]


def leaf(patch: Patch) -> Floats:
    """Paint clusters of leaves."""
    return _mottled(patch, (0.06, 0.025), (0.3, 0.3))


def sign(patch: Patch) -> Floats:
    """Paint road signs: warning, ban, information, speed."""
    radius = np.hypot(patch.uv[:, 0], patch.uv[:, 1])
    look = np.floor(np.mod(patch.key, 4))
    blue, red = np.array([0.02, 0.08, 0.4], np.float32), np.array([0.5, 0.02, 0.02], np.float32)
    white = np.full((len(radius), 3), 0.75, np.float32)
    rim = np.where((look == 2)[:, None], blue, red)
    face = np.where((look == 2)[:, None] & (np.abs(patch.uv[:, :1]) > 0.16), blue, white)
    figure = (np.abs(patch.uv[:, 0]) < 0.3) & (np.abs(patch.uv[:, 1]) < 0.09) & (look == 3)
    face = np.where(figure[:, None], np.float32(0.02), face)
    inner = np.where(look == 0, 0.33, 0.72)
    return np.where((radius > inner)[:, None], rim, face)


def plain(patch: Patch) -> Floats:
    """Paint matt things."""
    return _mottled(patch, (1.5, 0.3, 0.07, 0.02), (0.08, 0.07, 0.07, 0.08))


def lamp(patch: Patch) -> Floats:
    """Paint lamps: bulbs and ribs behind their glass."""
    ribs = 0.6 + 0.25 * octaves(patch.uv, patch.key, patch.footprint, (0.21, 0.07), (0.8, 0.5))
    return patch.tint * np.clip(ribs, 0.1, 1.1)[:, None]


def far(patch: Patch) -> Floats:
    """Paint distant houses with rows of windows, and wooded hills."""
    u, v = np.mod(patch.uv[:, 0], 3.0), np.mod(patch.uv[:, 1], 3.1)
    window = (np.abs(u - 1.5) < 0.6) & (np.abs(v - 1.5) < 0.7) & (np.abs(patch.key - 8.5) > 0.51)
    albedo = _mottled(patch, (60.0, 17.0, 5.0, 1.6, 0.5), (0.08, 0.08, 0.10, 0.12, 0.15))
    return albedo * np.where(window, 0.3, 1.0)[:, None]


PAINTERS: dict[Material, Callable[[Patch], Floats]] = {
    Material.ASPHALT: asphalt, Material.PAVEMENT: pavement, Material.KERB: kerb, Material.GRASS: grass,
    Material.PLASTER: plaster, Material.BRICK: brick, Material.ROOF: roof, Material.GLASS: glass, Material.DOOR: door,
    Material.PAINT: paint, Material.CAR_GLASS: car_glass, Material.RUBBER: plain, Material.METAL: metal,
    Material.BARK: bark, Material.LEAF: leaf, Material.SIGN: sign, Material.PLAIN: plain, Material.LAMP: lamp,
    Material.FAR: far, Material.RIM: rim, Material.PLATE: plate, Material.SHOP: shop, Material.CLOTH: cloth,
}  # fmt: skip


def albedo(material: npt.NDArray[np.uint8], patch: Patch) -> Floats:
    """Paint places (n,) of mixed materials: linear RGB (n, 3)."""
    out = np.zeros((len(material), 3), np.float32)
    for kind in np.unique(material):
        at = np.flatnonzero(material == kind)
        part = Patch(patch.uv[at], patch.key[at], patch.tint[at], patch.footprint[at], patch.config)
        out[at] = PAINTERS[Material(kind)](part)
    return out
