"""Augmentation of a labelled image for the sky mask: another window, another sky, other walls, another camera."""

from dataclasses import replace

import cv2
import numpy as np

from priors.adapt.augment import Augmentation, draw, to_light
from priors.adapt.camera_response import LUMA, Floats
from priors.adapt.distributions import Effect, LogUniform, Uniform
from priors.codecs import as_rgb
from priors.learn.sky_branches import grow_trees
from priors.learn.sky_labels import SKY, UNKNOWN, SkySample
from priors.sky import pixel_side
from priors.types import FloatMap, Image

DISPLAY_GAMMA = 2.2
"""Exponent from an image's levels to light."""
PHOTOMETRIC = Augmentation(
    grey=0.35,
    grey_concentration=(1.0, 1.5, 0.6),
    saturation=Uniform(0.4, 1.4),
    exposure=LogUniform(np.exp(-2), np.exp(1.3)),
    white_balance=Uniform(0.75, 1.3),
    gamma=LogUniform(np.exp(-0.35) / DISPLAY_GAMMA, np.exp(0.35) / DISPLAY_GAMMA),
    blur_px=Effect(0.2, Uniform(0.3, 1.2)),
    noise=Effect(0.5, Uniform(0, 0.02)),
)
"""Ranges that act on light, not on levels."""
BARE = 0.35
"""Probability of bare trees."""
ZOOM = LogUniform(0.75, 1.35)
"""Size of a window against what the mask sees of an image."""


def draw_view(sample: SkySample, size: tuple[int, int], rng: np.random.Generator) -> tuple[Image, Floats]:
    """Draw a window of an image, as another camera would show it under another sky.

    Args:
        sample: image and labels.
        size: height and width of the view.
        rng: decides it.

    Returns:
        the view, and (2, height / 2, width / 2): the share of sky, and of pixels whose label is known.
    """
    window = draw_window(sample.label.shape, size, rng)
    image, label = sample.image[window], sample.label[window]
    if rng.random() < 0.5:
        image, label = image[:, ::-1], label[:, ::-1]
    if rng.random() < BARE:
        image, label = grow_trees(image, label, rng)
    whole, half = (size[1], size[0]), (size[1] // 2, size[0] // 2)
    image = np.asarray(cv2.resize(np.ascontiguousarray(image), whole, interpolation=cv2.INTER_AREA), np.uint8)
    shares = [
        np.asarray(cv2.resize(mask.astype(np.float32), half, interpolation=cv2.INTER_AREA), np.float32)
        for mask in (label == SKY, label != UNKNOWN)
    ]
    sky = np.asarray(cv2.resize(shares[0], whole, interpolation=cv2.INTER_LINEAR), np.float32)
    return as_rgb(augment(image, sky, rng)), np.stack(shares)


def draw_window(shape: tuple[int, ...], size: tuple[int, int], rng: np.random.Generator) -> tuple[slice, slice]:
    """Draw rows and columns of an image that become a view of about the scale at which the mask sees it."""
    scale = pixel_side(shape[0], shape[1]) * float(ZOOM.draw(rng)[0])
    window = []
    for whole, part in zip(shape, size, strict=True):
        length = min(whole, max(2, round(part * scale)))
        first = int(rng.integers(0, whole - length + 1))
        window.append(slice(first, first + length))
    return window[0], window[1]


def augment(image: Image, sky: FloatMap, rng: np.random.Generator) -> Image:
    """Return an image as another camera would show it under another sky.

    Args:
        image: RGB or grey.
        sky: (height, width) share of sky.
        rng: decides it.
    """
    light = to_light(as_rgb(image), DISPLAY_GAMMA)
    if rng.random() < 0.5:
        light = change_sky(light, sky, rng)
    if rng.random() < 0.25:
        light = light_walls(light, sky, rng)
    ranges = PHOTOMETRIC if image.ndim == 3 else replace(PHOTOMETRIC, white_balance=None, saturation=None)
    return draw(rng, ranges, channels=3).shoot(light, rng)


def change_sky(light: Floats, sky: FloatMap, rng: np.random.Generator) -> Floats:
    """Make it early or late, cloudy or deep blue, or seen by a camera that sees little blue."""
    amount = sky[..., None]
    fall = 1 + rng.uniform(-0.5, 0.8) * np.linspace(0, 1, len(light), dtype=np.float32)[:, None, None]
    blue = rng.uniform(0.5, 1) if rng.random() < 0.5 else 1.0
    tint = np.array([blue**2, blue, 1], np.float32) * rng.uniform(0.15, 1)
    return np.asarray(light * (1 - amount + amount * tint * fall), np.float32)


def light_walls(light: Floats, sky: FloatMap, rng: np.random.Generator) -> Floats:
    """Let the sun shine on what is no sky, on some columns alone: pale walls as bright as the sky, or brighter."""
    width = light.shape[1]
    left, length = rng.uniform(-0.3, 0.8) * width, rng.uniform(0.2, 1) * width
    columns = np.arange(width, dtype=np.float32)
    lit = np.clip(np.minimum(columns - left, left + length - columns) / 4, 0, 1)[None, :, None]
    amount = lit * (1 - sky[..., None])
    grey = light @ LUMA
    pale = rng.uniform(0, 0.8)
    walls = (light + pale * (grey[..., None] - light)) * np.exp(rng.uniform(0.2, 1.8))
    return np.asarray(light + amount * (walls - light), np.float32)
