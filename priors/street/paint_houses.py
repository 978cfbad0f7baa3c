"""Albedo of houses: walls, roofs, windows, doors, shop signs, and of what is far away."""

import numpy as np

from priors.street.noise import band, fade, hash_, line, octaves
from priors.street.patch import Floats, Patch, mottled


def plaster(patch: Patch) -> Floats:
    """Paint rendered walls: stains that run down, and grain."""
    streaks = patch.uv * np.array([1.0, 0.12], np.float32)
    albedo = mottled(patch, (5.0, 1.3, 0.33, 0.09, 0.025), (0.05, 0.05, 0.05, 0.06, 0.08))
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
    albedo = mottled(patch, (9.0, 2.6, 0.8, 0.05, 0.017), (0.10, 0.09, 0.06, 0.07, 0.09)) * tone[:, None]
    return albedo * (1 - mortar) + np.float32(0.25) * mortar


def roof(patch: Patch) -> Floats:
    """Paint rows of tiles."""
    row, column = np.floor(patch.uv[:, 1] / 0.33), np.floor(patch.uv[:, 0] / 0.25)
    tone = np.exp((0.5 * hash_(row, column, patch.key) - 0.25) * fade(0.4, patch.footprint))
    shade = 1 - 0.35 * np.mod(patch.uv[:, 1] / 0.33, 1) ** 3 * fade(0.4, patch.footprint)
    return mottled(patch, (5.0, 1.2, 0.3, 0.06), (0.15, 0.12, 0.1, 0.12)) * (tone * shade)[:, None]


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


def shop(patch: Patch) -> Floats:
    """Paint a sign board: bold strokes on a ground of one colour."""
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    letter = np.floor(u / 0.34)
    stroke = hash_(np.floor(u / 0.085), np.floor(v / 0.1), np.floor(patch.key)) < 0.45
    wide = (np.mod(u, 0.34) < 0.27) & (hash_(np.floor(letter / 6), patch.key) < 0.8)
    ink = np.where(patch.tint.mean(axis=1) > 0.2, 0.03, 0.6)[:, None] * np.ones(3, np.float32)
    return np.where((stroke & wide)[:, None], ink, patch.tint)


def far(patch: Patch) -> Floats:
    """Paint distant houses with rows of windows, and wooded hills."""
    u, v = np.mod(patch.uv[:, 0], 3.0), np.mod(patch.uv[:, 1], 3.1)
    window = (np.abs(u - 1.5) < 0.6) & (np.abs(v - 1.5) < 0.7) & (np.abs(patch.key - 8.5) > 0.51)
    albedo = mottled(patch, (60.0, 17.0, 5.0, 1.6, 0.5), (0.08, 0.08, 0.10, 0.12, 0.15))
    return albedo * np.where(window, 0.3, 1.0)[:, None]
