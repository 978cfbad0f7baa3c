"""How the two views of a training pair look: light, exposure, colour, lens, noise and compression.

Most of it is drawn once for both views; a little, and now and then a lot, for each view on its own, as two cameras
with their own exposure have it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors.types import FloatMap, Image

MIDDLE = 0.25
"""The level, of 1, that contrast does not change: the median of street images."""


@dataclass(frozen=True)
class Range:
    """How far looks vary; spreads are of logarithms where nothing else is said."""

    grey: float = 0.35
    """Probability of grey images."""
    differs: float = 0.25
    """Probability that the two views differ much; they always do a little."""
    exposure: float = 0.25
    gamma: float = 0.12
    contrast: float = 0.12
    crisp: float = 1.0
    """What the contrast is multiplied by on average."""
    black: float = 0.0
    """What is added on average, grey levels."""
    colour: float = 0.06
    extreme: float = 0.07
    """Probability of a picture that is far too bright or far too dark."""
    blurred: float = 0.25
    """Probability that a view is out of focus; each view on its own half the time."""
    shaded: float = 0.25
    """Probability of corners darker than the middle."""
    noise: float = 6.0
    """Largest spread of the noise, grey levels."""
    compressed: float = 0.3
    """Probability of JPEG artefacts."""


@dataclass(frozen=True)
class Look:
    """How one camera shows the scene."""

    table: npt.NDArray[np.uint8]
    """(256,) for grey, (256, 1, 3) for colour: level in, level out."""
    blur_px: float
    shade: float
    """Share of the light lost in the corners."""
    noise: float
    """Spread, grey levels."""
    grain_px: float
    """Size of the noise's grains; 0: each pixel on its own."""
    quality: int
    """JPEG's; 0: not compressed."""


def change(left: Image, right: Image, rng: np.random.Generator, range_: Range) -> tuple[Image, Image]:
    """Return both views with another look; nothing moves."""
    if left.ndim == 3 and rng.random() < range_.grey:
        left, right = (np.asarray(cv2.cvtColor(a, cv2.COLOR_RGB2GRAY), np.uint8) for a in (left, right))
    if left.ndim == 3:
        mix = _saturation(float(np.exp(rng.normal(-0.1, 0.3))))
        left, right = (np.asarray(cv2.transform(a, mix), np.uint8) for a in (left, right))
    looks = draw(rng, range_, colour=left.ndim == 3)
    return show(left, looks[0], rng), show(right, looks[1], rng)


def draw(rng: np.random.Generator, range_: Range, colour: bool) -> tuple[Look, Look]:
    """Draw the looks of the left and the right view."""
    spread = np.array([range_.exposure, range_.gamma, range_.contrast, *([range_.colour] * 3)])
    shared = rng.normal(0, spread)
    shared[2] += np.log(range_.crisp)
    if rng.random() < range_.extreme:
        shared[0] = rng.uniform(0.5, 1.1) if rng.random() < 0.5 else rng.uniform(-2.2, -1.0)
    apart = 0.5 if rng.random() < range_.differs else 0.1
    blurred = rng.random(2) < range_.blurred if rng.random() < 0.5 else np.repeat(rng.random() < range_.blurred, 2)
    blur_px = blurred * rng.uniform(0.4, 1.3) * np.exp(rng.normal(0, 0.2, 2))
    shade = rng.uniform(0.1, 0.5) if rng.random() < range_.shaded else 0.0
    noise = np.exp(rng.uniform(np.log(0.4), np.log(range_.noise)) + rng.normal(0, 0.1, 2))
    grain_px = rng.uniform(0.4, 0.8) if rng.random() < 0.3 else 0.0
    quality = int(rng.integers(35, 96)) if rng.random() < range_.compressed else 0
    found = [
        Look(
            tone(shared + rng.normal(0, apart * spread), rng.normal(range_.black, 3.0), colour),
            float(blur_px[side]),
            float(shade * rng.uniform(0.8, 1.2)),
            float(noise[side]),
            grain_px,
            quality,
        )
        for side in (0, 1)
    ]
    return found[0], found[1]


def tone(logs: npt.NDArray[np.float64], black: float, colour: bool) -> npt.NDArray[np.uint8]:
    """Return the table of levels for logarithms of exposure, gamma, contrast, red, green, blue; black in levels."""
    gains = np.exp(logs[0] + (logs[3:] if colour else 0 * logs[3:4]))
    level = (np.arange(256) / 255)[:, None] ** np.exp(logs[1]) * gains
    level = (level - MIDDLE) * np.exp(logs[2]) + MIDDLE
    table = np.clip(np.rint(255 * level + black), 0, 255).astype(np.uint8)
    return table[:, None] if colour else table[:, 0]


def show(image: Image, look: Look, rng: np.random.Generator) -> Image:
    """Return the image (h, w) or (h, w, 3) as a camera with this look has it."""
    image = np.asarray(cv2.LUT(image, look.table), np.uint8)
    if look.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), look.blur_px), np.uint8)
    light = image.astype(np.float32)
    if look.shade > 0:
        falloff = _falloff(image.shape[:2], look.shade)
        light *= falloff if image.ndim == 2 else falloff[..., None]
    grain = rng.standard_normal(image.shape, np.float32)
    if look.grain_px > 0:
        grain = np.asarray(cv2.GaussianBlur(grain, (5, 5), look.grain_px), np.float32)
        grain *= np.float32(2 * np.sqrt(np.pi) * look.grain_px)
    grain *= np.float32(look.noise)
    light += grain
    image = np.clip(light + np.float32(0.5), 0, 255, out=light).astype(np.uint8)
    return _compress(image, look.quality) if look.quality else image


def _saturation(factor: float) -> npt.NDArray[np.float64]:
    """Return the matrix that scales colours' distance from grey."""
    grey = np.tile([0.299, 0.587, 0.114], (3, 1))
    return np.asarray(grey + factor * (np.eye(3) - grey))


def _falloff(size: tuple[int, ...], shade: float) -> FloatMap:
    y, x = (np.linspace(-1, 1, side, dtype=np.float32) for side in size)
    return np.float32(1) - np.float32(shade / 2) * (y[:, None] ** 2 + x**2)


def _compress(image: Image, quality: int) -> Image:
    _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    flag = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
    return np.asarray(cv2.imdecode(code, flag), np.uint8)
