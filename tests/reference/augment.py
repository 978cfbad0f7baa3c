"""Slow twin of priors/adapt/augment.py: the augmentation of single images, and a camera's tone curve, step by step."""

import cv2
import numpy as np


def single_image(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Augment an image (h, w, 3) by the ranges of SINGLE_IMAGE; adapted weights rest on its very numbers."""
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


def tone(light: float, light_gain: float, gamma: float, level_gain: float, contrast: float) -> float:
    """Turn the light of one pixel into a level, about a pivot of 0.5."""
    exposed = min(max(light * light_gain, 0.0), 1.0)
    return (exposed**gamma * level_gain - 0.5) * contrast + 0.5
