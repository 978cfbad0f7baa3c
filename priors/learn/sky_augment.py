"""Augmentation of a labelled image for the sky mask: another crop, another sky, another camera."""

from dataclasses import replace

import cv2
import numpy as np

from priors.adapt.augment import Augmentation, draw, to_light
from priors.adapt.camera_response import Floats
from priors.adapt.distributions import Effect, LogUniform, Uniform
from priors.codecs import as_rgb
from priors.learn.sky_labels import SKY
from priors.types import FloatMap, Image

DISPLAY_GAMMA = 2.2
"""Exponent from an image's levels to light."""
PHOTOMETRIC = Augmentation(
    grey=0.35,
    grey_concentration=(1.0, 1.5, 0.6),
    exposure=LogUniform(np.exp(-2), np.exp(1.3)),
    white_balance=Uniform(0.75, 1.3),
    gamma=LogUniform(np.exp(-0.35) / DISPLAY_GAMMA, np.exp(0.35) / DISPLAY_GAMMA),
    noise=Effect(0.5, Uniform(0, 0.02)),
)
"""Ranges that act on light, not on levels."""


def augment(image: Image, label: FloatMap, rng: np.random.Generator) -> tuple[Image, FloatMap]:
    """Return an image as another camera would show it under another sky, and its labels."""
    image, label = crop(image, label, rng)
    light = to_light(as_rgb(image), DISPLAY_GAMMA)
    if rng.random() < 0.5:
        light = change_sky(light, label, rng)
    ranges = PHOTOMETRIC if image.ndim == 3 else replace(PHOTOMETRIC, white_balance=None)
    return draw(rng, ranges, channels=3).shoot(light, rng), label


def change_sky(light: Floats, label: FloatMap, rng: np.random.Generator) -> Floats:
    """Make it early or late, cloudy or deep blue, or seen by a camera that sees little blue."""
    amount = cv2.GaussianBlur((label == SKY).astype(np.float32), (3, 3), 0)[..., None]
    fall = 1 + rng.uniform(-0.5, 0.8) * np.linspace(0, 1, len(light), dtype=np.float32)[:, None, None]
    blue = rng.uniform(0.5, 1) if rng.random() < 0.5 else 1.0
    tint = np.array([blue**2, blue, 1], np.float32) * rng.uniform(0.15, 1)
    return np.asarray(light * (1 - amount + amount * tint * fall), np.float32)


def crop(image: Image, label: FloatMap, rng: np.random.Generator) -> tuple[Image, FloatMap]:
    """Cut another aspect, mostly with the horizon (half way down) where a car's camera has it; sometimes no sky."""
    height, width = label.shape
    if rng.random() < 0.6:
        rows = int(rng.uniform(0.36, 1) * height)
        place = rng.uniform(-0.1, 0.05) if rng.random() < 0.12 else rng.uniform(0.38, 0.55)
        top = int(np.clip(0.5 * height + rng.uniform(-15, 15) - place * rows, 0, height - rows))
        image, label = image[top : top + rows], label[top : top + rows]
    if rng.random() < 0.4:
        columns = int(rng.uniform(0.4, 1) * width)
        left = int(rng.integers(0, width - columns + 1))
        image, label = image[:, left : left + columns], label[:, left : left + columns]
    return (image[:, ::-1], label[:, ::-1]) if rng.random() < 0.5 else (image, label)
