"""Albedo of cars, plants, poles, signs and clothes."""

import numpy as np

from priors.street.noise import band, hash_, line, octaves
from priors.street.patch import Floats, Patch, mottled


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
    return mottled(patch, (0.7, 0.12, 0.03), (0.12, 0.10, 0.10))


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


def lamp(patch: Patch) -> Floats:
    """Paint lamps: bulbs and ribs behind their glass."""
    ribs = 0.6 + 0.25 * octaves(patch.uv, patch.key, patch.footprint, (0.21, 0.07), (0.8, 0.5))
    return patch.tint * np.clip(ribs, 0.1, 1.1)[:, None]


def bark(patch: Patch) -> Floats:
    """Paint furrowed bark."""
    furrows = patch.uv * np.array([1.0, 0.25], np.float32)
    deep = octaves(furrows, patch.key, patch.footprint, (0.09, 0.03), (0.35, 0.3))
    return mottled(patch, (1.0, 0.25), (0.25, 0.2)) * np.exp(deep)[:, None]


def leaf(patch: Patch) -> Floats:
    """Paint clusters of leaves."""
    return mottled(patch, (0.06, 0.025), (0.3, 0.3))


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
    return mottled(patch, (1.5, 0.3, 0.07, 0.02), (0.08, 0.07, 0.07, 0.08))


def cloth(patch: Patch) -> Floats:
    """Paint clothes: folds."""
    return mottled(patch, (0.35, 0.12, 0.04), (0.15, 0.15, 0.1))
