"""Albedo of what lies flat: carriageway with its marks, pavement, kerbs, lawn."""

import numpy as np

from priors.street.noise import band, fade, hash_, line, octaves
from priors.street.patch import Floats, Patch, mottled


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
    albedo = mottled(patch, (11.0, 2.7, 0.6, 0.14, 0.04, 0.014), (0.10, 0.10, 0.07, 0.09, 0.13, 0.18))
    return albedo * (tone * (1 - 0.5 * joint))[:, None]


def kerb(patch: Patch) -> Floats:
    """Paint kerb stones a metre long."""
    joint = line(np.mod(patch.uv[:, 0], 1.0) - 0.5, 0.008, patch.footprint)
    tone = 1 + (0.24 * hash_(np.floor(patch.uv[:, 0] + 0.5), np.floor(patch.key)) - 0.12)
    return mottled(patch, (3.0, 0.4, 0.08, 0.02), (0.12, 0.1, 0.12, 0.15)) * (tone * (1 - 0.6 * joint))[:, None]


def grass(patch: Patch) -> Floats:
    """Paint lawn and soil."""
    albedo = mottled(patch, (17.0, 4.0, 0.9, 0.22, 0.06, 0.02), (0.18, 0.2, 0.2, 0.25, 0.35, 0.35))
    dry = np.clip(0.3 * band(patch.uv, 3.7, patch.key, 3) + 0.1, 0, 0.6)[:, None]
    return albedo * (1 + dry * np.array([0.9, 0.35, 0.3], np.float32))
