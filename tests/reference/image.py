"""The image metrics as their formulas read: one window at a time. Slow, and what eval.image must equal."""

import math

import numpy as np


def ssim(image, truth, window, data_range, unbias):
    """Mean SSIM over channels and windows that lie inside; window (k, k) weights that sum to 1."""
    size = len(window)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    values = []
    for channel in range(image.shape[2]):
        for top in range(image.shape[0] - size + 1):
            for left in range(image.shape[1] - size + 1):
                x = image[top : top + size, left : left + size, channel].astype(np.float64)
                y = truth[top : top + size, left : left + size, channel].astype(np.float64)
                mx, my = np.sum(window * x), np.sum(window * y)
                vx, vy = np.sum(window * (x - mx) ** 2) * unbias, np.sum(window * (y - my) ** 2) * unbias
                both = np.sum(window * (x - mx) * (y - my)) * unbias
                values.append((2 * mx * my + c1) * (2 * both + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))
    return math.fsum(values) / len(values)


def gauss_window(size=11, sigma=1.5):
    """(size, size) weights of a Gaussian, sum 1."""
    weights = [[math.exp(-(i**2 + j**2) / (2 * sigma**2)) for j in range(-(size // 2), size // 2 + 1)]
               for i in range(-(size // 2), size // 2 + 1)]  # fmt: skip
    return np.array(weights) / np.sum(weights)


def psnr(image, truth, data_range):
    """Decibels of two arrays, one value at a time."""
    pairs = zip(image.ravel().tolist(), truth.ravel().tolist(), strict=True)
    mse = math.fsum((a - b) ** 2 for a, b in pairs) / image.size
    return math.inf if mse == 0 else 10 * math.log10(data_range**2 / mse)
