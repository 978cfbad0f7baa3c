"""Diffusion along image columns: the exact solution of a tridiagonal system in each, all columns side by side."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled

Map = npt.NDArray[np.float32]


@compiled
def link_columns(
    grey: npt.NDArray[np.uint8], disparity_px: Map, slope_px: float, edge_grey: float, edge_px: float
) -> Map:
    """Return how strongly every pixel is tied to the one below it: (height, width), in (0, 1], 0 in the last row.

    The tie is exp(-step): grey levels of the image's step over edge_grey, plus the part of the disparity's step that
    is above slope_px over edge_px. Pixels without a disparity (0) are tied by the image alone.
    """
    height, width = grey.shape
    per_grey = np.float32(8.0)  # steps are looked up in a table at an eighth of a grey level
    per_px = np.float32(8.0 * edge_grey / edge_px)
    table = np.exp(-np.arange(1024) / (8.0 * edge_grey)).astype(np.float32)
    slope = np.float32(slope_px)
    links = np.zeros((height, width), dtype=np.float32)
    for y in range(height - 1):
        for x in range(width):
            step = per_grey * abs(np.float32(grey[y, x]) - np.float32(grey[y + 1, x]))
            above, below = disparity_px[y, x], disparity_px[y + 1, x]
            if above > 0 and below > 0:
                step += per_px * max(abs(above - below) - slope, np.float32(0))
            links[y, x] = table[min(np.int32(step), np.int32(1023))]
    return links


@compiled(fastmath=FAST)
def diffuse_columns(first: Map, second: Map, links: Map, strength: float) -> None:
    """Solve (I + strength L) u = map for two maps (height, width) in place, L the columns' weighted Laplacian.

    Thomas' algorithm, the row as the innermost loop. The solution keeps constants and lies between the map's extremes.
    """
    height, width = first.shape
    ratio = np.zeros((height, width), dtype=np.float32)  # the eliminated upper diagonal, negated
    upper = np.zeros(width, dtype=np.float32)
    weight = np.float32(strength)
    for y in range(height):
        for x in range(width):
            lower = weight * links[y, x]
            from_above = upper[x]
            before = y - 1 if y > 0 else 0
            pivot = np.float32(1) / (np.float32(1) + from_above + lower - from_above * ratio[before, x])
            ratio[y, x] = lower * pivot
            first[y, x] = (first[y, x] + from_above * first[before, x]) * pivot
            second[y, x] = (second[y, x] + from_above * second[before, x]) * pivot
            upper[x] = lower
    for y in range(height - 2, -1, -1):
        for x in range(width):
            first[y, x] += ratio[y, x] * first[y + 1, x]
            second[y, x] += ratio[y, x] * second[y + 1, x]
