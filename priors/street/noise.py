"""Band-limited noise at any place on a surface: one tile, read at many scales and turns so that it never repeats."""

from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]
SIDE = 512
CELLS = 64
GOLDEN_ANGLE_RAD = 2.39996
"""Between one octave and the next: no two line up."""


@cache
def tile() -> Floats:
    """Return (SIDE, SIDE) noise of zero mean and unit deviation, most of it CELLS waves a side; it wraps around."""
    rng = np.random.default_rng(20110926)
    spectrum = np.fft.fft2(rng.normal(size=(SIDE, SIDE)))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE, 1 / SIDE), np.fft.fftfreq(SIDE, 1 / SIDE)))
    spectrum *= np.exp(-(((frequency - CELLS) / (0.45 * CELLS)) ** 2))
    field = np.real(np.fft.ifft2(spectrum))
    return (field / field.std()).astype(np.float32)


def band(uv_m: Floats, wave_m: float, key: Floats, number: int = 0) -> Floats:
    """Return noise (n,) with about wave_m between its crests, at surface places (n, 2) of surfaces with keys (n,)."""
    angle = np.float32(number * GOLDEN_ANGLE_RAD + 0.3)
    scale = np.float32(SIDE / (CELLS * wave_m))
    cos, sin = np.cos(angle) * scale, np.sin(angle) * scale
    u = uv_m[:, 0] * cos - uv_m[:, 1] * sin + key * np.float32(37.17)
    v = uv_m[:, 0] * sin + uv_m[:, 1] * cos + key * np.float32(61.93)
    return sample(u, v)


def sample(u: Floats, v: Floats) -> Floats:
    """Read the tile at (n,) texel places, bilinear, wrapping."""
    n, width = len(u), 1024
    rows = max(1, -(-n // width))  # remap refuses an empty map
    maps = np.zeros((2, rows * width), np.float32)
    for row, place in zip(maps, (u, v), strict=True):
        turns = place * np.float32(1 / SIDE)
        np.multiply(turns - np.floor(turns), np.float32(SIDE), out=row[:n])  # np.mod takes four times as long
    grid = maps.reshape(2, rows, width)
    read = cv2.remap(tile(), grid[0], grid[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(read.reshape(-1)[:n], np.float32)


def octaves(
    uv_m: Floats, key: Floats, footprint_m: Floats, waves_m: tuple[float, ...], gains: tuple[float, ...]
) -> Floats:
    """Sum noise bands; a band fades out where a pixel covers more than half its wave."""
    total = np.zeros(len(uv_m), np.float32)
    for number, (wave, gain) in enumerate(zip(waves_m, gains, strict=True)):
        share = fade(wave, footprint_m)
        resolved = np.flatnonzero(share > 0.02)
        if resolved.size == len(uv_m):
            total += gain * share * band(uv_m, wave, key, number)
        elif resolved.size:
            total[resolved] += gain * share[resolved] * band(uv_m[resolved], wave, key[resolved], number)
    return total


def fade(wave_m: float, footprint_m: Floats) -> Floats:
    """Return how much (0..1) of a detail of that size a pixel of that footprint still resolves."""
    return np.clip(np.float32(1.3) - 1.3 * footprint_m / np.float32(0.5 * wave_m), 0, 1).astype(np.float32)


def hash_(*parts: Floats) -> Floats:
    """Return a number in [0, 1) for each tuple of whole numbers."""
    total = np.zeros_like(parts[0], dtype=np.float64)
    for part, factor in zip(parts, (12.9898, 78.233, 37.719), strict=False):
        total = total + np.round(part).astype(np.float64) * factor
    value = np.sin(total) * 43758.5453
    return (value - np.floor(value)).astype(np.float32)


def line(distance_m: Floats, half_width_m: float | Floats, footprint_m: Floats) -> Floats:
    """Return the share (0..1) of a pixel that a line covers, given the pixel's distance from the line's middle."""
    pixel = np.maximum(footprint_m, np.float32(0.004))
    first = np.maximum(distance_m - 0.5 * pixel, -half_width_m)
    last = np.minimum(distance_m + 0.5 * pixel, half_width_m)
    return np.maximum(last - first, 0) / pixel
