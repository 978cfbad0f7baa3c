"""Photometric augmentation of an image: exposure, contrast, colour, sharpness and noise."""

import cv2
import numpy as np

from priors.types import Image


def augment(image: Image, rng: np.random.Generator) -> Image:
    """Change exposure, contrast, colour, sharpness and noise as cameras do."""
    values = image.astype(np.float32) / 255
    if rng.random() < 0.15:
        values[:] = values.mean(axis=2, keepdims=True)
    gain = (rng.uniform(0.6, 1.5) * (1 + rng.normal(0, 0.06, 3))).astype(np.float32)
    gamma, contrast = np.float32(rng.uniform(0.75, 1.3)), np.float32(rng.uniform(0.8, 1.25))
    values = ((np.clip(values * gain, 0, 1) ** gamma - 0.4) * contrast + 0.4).astype(np.float32)
    if rng.random() < 0.3:
        values[:] = cv2.GaussianBlur(values, (0, 0), rng.uniform(0.4, 1.1))
    values += rng.normal(0, rng.uniform(0, 0.025), (*values.shape[:2], 1)).astype(np.float32)
    return (np.clip(values, 0, 1) * 255).astype(np.uint8)
