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

Floats = npt.NDArray[np.float32]


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
    """Paint a worn carriageway with lane marks, tyre tracks, patches and cracks."""
    albedo = _mottled(patch, (23.0, 6.1, 1.7, 0.47, 0.13, 0.041, 0.015), (0.10, 0.10, 0.08, 0.10, 0.16, 0.22, 0.3))
    s, t = patch.uv[:, 0], patch.uv[:, 1]
    lane = patch.config.lane_m
    tracks = np.cos(2 * np.pi * (t / lane * 2))
    albedo *= (1 - 0.05 * tracks)[:, None]
    cracks = np.abs(band(patch.uv, 3.1, patch.key, 5) + 0.25 * band(patch.uv, 0.31, patch.key, 6))
    where = band(patch.uv, 9.0, patch.key, 7) > 0.9
    albedo *= (1 - 0.6 * np.where(where, line(cracks, 0.03, patch.footprint * 2), 0))[:, None]
    cell_s = np.floor(s / 7.3)
    cell_t = np.floor((t + 0.3 * cell_s) / 2.9)
    chance = hash_(cell_s, cell_t)
    size_s = 1.0 + 2.2 * hash_(cell_s, cell_t + 50)
    in_patch = (chance < 0.10) & (np.abs(s / 7.3 - cell_s - 0.5) * 7.3 < size_s)
    albedo *= np.where(in_patch, 0.62 + 0.5 * hash_(cell_s, cell_t + 9), 1.0)[:, None]
    main = patch.key < 1.0
    paint = np.where(main, _marks(patch), 0)
    worn = np.clip(
        0.85 + 0.35 * octaves(patch.uv, patch.key + 3, patch.footprint, (0.6, 0.11, 0.03), (0.5, 0.5, 0.5)), 0, 1
    )
    cover = (paint * worn)[:, None]
    return albedo * (1 - cover) + np.float32(0.55) * cover


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
    tone = 1 + (0.30 * hash_(row, column, patch.key) - 0.15) * fade(0.5, patch.footprint)
    joint = np.maximum(
        line(np.mod(along, size) - 0.5 * size, 0.006, patch.footprint),
        line(np.mod(patch.uv[:, 1], size) - 0.5 * size, 0.006, patch.footprint),
    )
    albedo = _mottled(patch, (11.0, 2.7, 0.6, 0.14, 0.04, 0.014), (0.12, 0.12, 0.08, 0.09, 0.12, 0.15))
    return albedo * (tone * (1 - 0.5 * joint))[:, None]


def kerb(patch: Patch) -> Floats:
    """Paint kerb stones a metre long."""
    joint = line(np.mod(patch.uv[:, 0], 1.0) - 0.5, 0.008, patch.footprint)
    tone = 1 + (0.24 * hash_(np.floor(patch.uv[:, 0] + 0.5), patch.key) - 0.12)
    return _mottled(patch, (3.0, 0.4, 0.08, 0.02), (0.12, 0.1, 0.12, 0.15)) * (tone * (1 - 0.6 * joint))[:, None]


def grass(patch: Patch) -> Floats:
    """Paint lawn and soil."""
    albedo = _mottled(patch, (17.0, 4.0, 0.9, 0.22, 0.06, 0.02), (0.18, 0.2, 0.2, 0.25, 0.35, 0.35))
    dry = np.clip(0.4 * band(patch.uv, 3.7, patch.key, 3) + 0.15, 0, 0.8)[:, None]
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
    resolved = fade(0.16, patch.footprint)
    tone = np.exp((0.9 * hash_(row, column, patch.key) - 0.45) * resolved)
    mortar = np.maximum(
        line((np.mod(along, 1) - 0.5) * width, 0.005, patch.footprint),
        line(np.mod(patch.uv[:, 1], height) - 0.5 * height, 0.005, patch.footprint),
    )[:, None] * 0.6  # fmt: skip
    albedo = _mottled(patch, (4.0, 1.1, 0.3, 0.05, 0.017), (0.12, 0.1, 0.08, 0.1, 0.12)) * tone[:, None]
    return albedo * (1 - mortar) + np.float32(0.32) * mortar


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
    """Paint car bodies: even, a little dusty."""
    return _mottled(patch, (1.1, 0.2), (0.03, 0.02))


def car_glass(patch: Patch) -> Floats:
    """Paint dark panes in a frame of the body's colour."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    edge = line(np.minimum(np.minimum(u, 1 - u), np.minimum(v + 0.04, 1 - v)), 0.055, patch.footprint)[:, None]
    seats = 0.02 * (np.abs(u - 0.5) < 0.28) * (v < 0.5)
    return (np.float32(0.010) + seats[:, None]) * (1 - edge) + patch.tint * 0.8 * edge


def metal(patch: Patch) -> Floats:
    """Paint poles and rims; rims (key 7, uv -1..1) have spokes."""
    albedo = _mottled(patch, (0.7, 0.12, 0.03), (0.15, 0.12, 0.12))
    angle = np.arctan2(patch.uv[:, 1], patch.uv[:, 0])
    radius = np.hypot(patch.uv[:, 0], patch.uv[:, 1])
    gap = (np.cos(angle * 7) < -0.1) & (radius > 0.3) & (radius < 0.88) & (patch.footprint < 0.15)
    is_rim = (patch.key >= 7) & (np.abs(patch.uv) <= 1.001).all(axis=1)
    return np.where((is_rim & gap)[:, None], albedo * 0.15, albedo)


def bark(patch: Patch) -> Floats:
    """Paint furrowed bark."""
    furrows = patch.uv * np.array([1.0, 0.25], np.float32)
    deep = octaves(furrows, patch.key, patch.footprint, (0.09, 0.03), (0.35, 0.3))
    return _mottled(patch, (1.0, 0.25), (0.25, 0.2)) * np.exp(deep)[:, None]


def leaf(patch: Patch) -> Floats:
    """Paint clusters of leaves."""
    return _mottled(patch, (0.09, 0.035), (0.35, 0.35))


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
    """Paint lamps and plates: ribs and letters."""
    ribs = 0.75 + 0.25 * band(patch.uv, 0.06, patch.key)
    return patch.tint * np.clip(ribs, 0.15, 1.2)[:, None]


def far(patch: Patch) -> Floats:
    """Paint distant houses with rows of windows, and wooded hills."""
    u, v = np.mod(patch.uv[:, 0], 3.0), np.mod(patch.uv[:, 1], 3.1)
    window = (np.abs(u - 1.5) < 0.6) & (np.abs(v - 1.5) < 0.7) & (np.abs(patch.key - 8.5) > 0.51)
    albedo = _mottled(patch, (60.0, 17.0, 5.0, 1.6, 0.5), (0.2, 0.2, 0.2, 0.2, 0.2))
    return albedo * np.where(window, 0.3, 1.0)[:, None]


PAINTERS: dict[Material, Callable[[Patch], Floats]] = {
    Material.ASPHALT: asphalt, Material.PAVEMENT: pavement, Material.KERB: kerb, Material.GRASS: grass,
    Material.PLASTER: plaster, Material.BRICK: brick, Material.ROOF: roof, Material.GLASS: glass, Material.DOOR: door,
    Material.PAINT: paint, Material.CAR_GLASS: car_glass, Material.RUBBER: plain, Material.METAL: metal,
    Material.BARK: bark, Material.LEAF: leaf, Material.SIGN: sign, Material.PLAIN: plain, Material.LAMP: lamp,
    Material.FAR: far,
}  # fmt: skip


def albedo(material: npt.NDArray[np.uint8], patch: Patch) -> Floats:
    """Paint places (n,) of mixed materials: linear RGB (n, 3)."""
    out = np.zeros((len(material), 3), np.float32)
    for kind in np.unique(material):
        at = np.flatnonzero(material == kind)
        part = Patch(patch.uv[at], patch.key[at], patch.tint[at], patch.footprint[at], patch.config)
        out[at] = PAINTERS[Material(kind)](part)
    return out
