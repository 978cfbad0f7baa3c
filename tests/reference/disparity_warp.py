"""Slow twins of priors/kernels/disparity_warp.py."""

import numpy as np


def see_right(disparity_px: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel of the right view look through all pieces of the left row for the nearest that covers it."""
    height, width = disparity_px.shape
    column, seen_px = np.full((height, width), -1.0), np.full((height, width), -1.0)
    for y in range(height):
        pieces = []
        for x in range(width):
            d = float(disparity_px[y, x])
            left = float(disparity_px[y, x - 1]) if x else np.inf
            right = float(disparity_px[y, x + 1]) if x + 1 < width else np.inf
            if abs(right - d) <= step:
                pieces.append((x, x + 1, d, right))
            else:
                pieces.append((x, x + 0.5, d, d))
            if not abs(left - d) <= step:
                pieces.append((x - 0.5, x, d, d))
        for u in range(width):
            for x0, x1, d0, d1 in pieces:
                u0, u1 = x0 - d0, x1 - d1
                if u0 <= u <= u1:
                    share = (u - u0) / (u1 - u0)
                    px = d0 + share * (d1 - d0)
                    if px > seen_px[y, u]:
                        seen_px[y, u], column[y, u] = px, x0 + share * (x1 - x0)
    return column, seen_px
