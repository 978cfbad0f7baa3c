"""Slow twin of priors/kernels/carry.py: for each pixel now, look through all patches of the frame before."""

import numpy as np


def carry(
    disparity_px: np.ndarray, trust: np.ndarray, T_now_before: np.ndarray, K: np.ndarray, fx_baseline: float
) -> tuple[np.ndarray, np.ndarray]:
    height, width = disparity_px.shape
    patches = []
    for y, x in zip(*np.nonzero(np.isfinite(disparity_px) & (disparity_px > 0)), strict=True):
        z = fx_baseline / float(disparity_px[y, x])
        point = T_now_before[:3] @ [*(np.linalg.inv(K) @ [x, y, 1] * z), 1]
        if not point[2] > 0.1:
            continue
        u, v, _ = K @ point / point[2]
        steps = [slope(disparity_px[y], x), slope(disparity_px[:, x], y)]
        patches.append((u, v, fx_baseline / point[2], steps, 0.5 * max(z / point[2], 1) ** 2 + 0.01, trust[y, x]))
    out, out_trust = np.zeros((height, width)), np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            nearest = np.inf
            for u, v, px, (along_x, along_y), reach, sure in patches:
                if abs(column - u) > reach or abs(row - v) > reach:
                    continue
                value = px + along_x * (column - u) + along_y * (row - v)
                away = (column - u) ** 2 + (row - v) ** 2
                if value > out[row, column] + 1 or (value > out[row, column] - 1 and away < nearest):
                    out[row, column], out_trust[row, column], nearest = max(value, 0), sure, away
    return out, out_trust


def slope(line: np.ndarray, place: int) -> float:
    if not 0 < place < len(line) - 1:
        return 0.0
    step = 0.5 * (float(line[place + 1]) - float(line[place - 1]))
    return step if abs(step) <= 1 else 0.0
