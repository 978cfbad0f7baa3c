"""Camera response: how one camera turns the light of a scene into an image; nothing moves.

The order is a camera's: colour, exposure, tone curve, gain and contrast, focus, vignette, noise, 8 bits, JPEG.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors.types import FloatMap, Image

Floats = npt.NDArray[np.float32]
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""How bright red, green and blue look (ITU-R BT.601)."""
GRAIN_WINDOW = (5, 5)


@dataclass(frozen=True)
class CameraResponse:
    """One camera's parameters. Levels are shares of white, from 0 to 1. The defaults change nothing."""

    grey_weights: tuple[float, ...] | None = None
    """How much red, green and blue count in a grey image, of mean 1; None: colours stay."""
    saturation: float = 1.0
    """Factor on the colours' distance from grey."""
    light_gain: tuple[float, ...] = (1.0,)
    """One for each channel, or for all: factor on the light: exposure and white balance. Light beyond white is lost."""
    gamma: float = 1.0
    """Exponent of the tone curve, from light to level."""
    level_gain: tuple[float, ...] = (1.0,)
    """One for each channel, or for all: factor on the level, after the tone curve."""
    contrast: float = 1.0
    """Factor on the level's distance from the pivot."""
    pivot: float = 0.5
    """The level that contrast does not change."""
    black: float = 0.0
    """What is added to all levels."""
    clipped: bool = True
    """Levels are cut to 0 .. 1 before focus, vignette and noise; else after them only."""
    blur_px: float = 0.0
    """Deviation of the Gaussian of a view out of focus."""
    vignette: float = 0.0
    """Share of the light lost in the corners."""
    noise: float = 0.0
    """Deviation of the noise, a level."""
    colour_noise: bool = True
    """Each channel has a noise of its own; else all have the same."""
    grain_px: float = 0.0
    """Size of the noise's grains; 0: each pixel is on its own."""
    quality: int = 0
    """Of JPEG, 1 to 100; 0: not compressed."""
    rounding: float = 0.5
    """What is added before the fraction of an 8-bit level is cut off."""

    def shoot(self, light: Floats, rng: np.random.Generator) -> Image:
        """Take a picture.

        Args:
            light: (h, w, channels) from 0 to 1, one or three channels.
            rng: draws the noise.

        Returns:
            (h, w, 3), or (h, w) where one channel is left.
        """
        levels = self.tone(self.mix(light))
        if self.clipped:
            np.clip(levels, 0, 1, out=levels)
        if self.blur_px > 0:
            levels = _blur(levels, (0, 0), self.blur_px)
        if self.vignette > 0:
            levels *= falloff(levels.shape[:2], self.vignette)[..., None]
        if self.noise > 0:
            levels += self._draw_noise(levels.shape, rng)
        np.clip(levels, 0, 1, out=levels)
        levels *= 255
        levels += np.float32(self.rounding)
        image = levels.astype(np.uint8)
        image = image[..., 0] if image.shape[2] == 1 else image
        return compress(image, self.quality) if self.quality else image

    def mix(self, light: Floats) -> Floats:
        """Make colours (h, w, 3) grey, (h, w, 1), or more or less saturated; grey stays."""
        if light.shape[2] == 3 and self.grey_weights is not None:
            return (light * np.array(self.grey_weights, np.float32)).mean(axis=2, keepdims=True)
        if light.shape[2] == 3 and self.saturation != 1:
            grey = np.tile(LUMA, (3, 1))
            matrix = grey + np.float32(self.saturation) * (np.eye(3, dtype=np.float32) - grey)
            return np.asarray(cv2.transform(light, matrix), np.float32)
        return light

    def tone(self, light: Floats) -> Floats:
        """Turn light (..., channels) into levels, which may lie outside 0 .. 1; the light stays as it is."""
        levels = scale(light, self.light_gain)
        np.clip(levels, 0, 1, out=levels)
        if self.gamma != 1:
            np.power(levels, np.float32(self.gamma), out=levels)
        if self.level_gain != (1.0,):
            levels = scale(levels, self.level_gain)
        if self.contrast != 1:
            levels -= np.float32(self.pivot)
            levels *= np.float32(self.contrast)
            levels += np.float32(self.pivot)
        if self.black:
            levels += np.float32(self.black)
        return levels

    def _draw_noise(self, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
        channels = shape[2] if self.colour_noise else 1
        noise = rng.normal(0, self.noise, (*shape[:2], channels)).astype(np.float32)
        if self.grain_px > 0:  # a blur of this width lowers the deviation by 2 sqrt(pi) grain_px
            noise = _blur(noise, GRAIN_WINDOW, self.grain_px) * np.float32(2 * np.sqrt(np.pi) * self.grain_px)
        return noise


def _blur(values: Floats, window: tuple[int, int], deviation_px: float) -> Floats:
    """Blur (h, w, channels) by a Gaussian; a window of (0, 0) is as large as needed."""
    return np.asarray(cv2.GaussianBlur(values, window, deviation_px), np.float32).reshape(values.shape)


def scale(values: Floats, gains: tuple[float, ...]) -> Floats:
    """Return values (h, w, channels) times one gain for all channels, or one for each; one channel becomes three."""
    if len(gains) == 1:
        return values * np.float32(gains[0])
    height, width, channels = values.shape
    each = values if channels == len(gains) else np.repeat(values, len(gains), axis=2)
    row = np.tile(np.array(gains, np.float32), width)  # whole rows: numpy is slow over a last axis of three
    return (each.reshape(height, -1) * row).reshape(height, width, len(gains))


def falloff(size: tuple[int, ...], vignette: float) -> FloatMap:
    """Return the share of light (height, width) that arrives: 1 in the middle, 1 - vignette in the corners."""
    y, x = (np.linspace(-1, 1, side, dtype=np.float32) for side in size)
    return np.float32(1) - np.float32(vignette / 2) * (y[:, None] ** 2 + x**2)


def compress(image: Image, quality: int) -> Image:
    """Return an image (h, w) or (h, w, 3) as JPEG of a quality from 1 to 100 leaves it."""
    _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    flag = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
    return np.asarray(cv2.imdecode(code, flag), np.uint8)
