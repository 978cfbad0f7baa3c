"""Photometric augmentation: images as another camera, another light or another exposure would show them.

`Augmentation` holds the ranges, `draw` turns them into a camera's response, `augment` and `augment_pair` apply it.
Every training has its own ranges: SINGLE_IMAGE here for one image, learn/stereo_augment.py for the two views of a pair,
learn/sky_augment.py for the sky mask.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from priors.adapt.camera_response import LUMA, CameraResponse, Floats
from priors.adapt.distributions import Distribution, Effect, LogNormal, LogUniform, Normal, Uniform
from priors.codecs import as_rgb
from priors.types import Image

EXTREME_BRIGHT, EXTREME_DARK = LogUniform(np.exp(0.5), np.exp(1.1)), LogUniform(np.exp(-2.2), np.exp(-1.0))
"""Gain of images that are far too bright or far too dark."""


@dataclass(frozen=True)
class Augmentation:
    """Ranges of the photometric augmentation. What is None or has probability 0 is left out.

    Levels are shares of white, from 0 to 1.
    """

    grey: float = 0.0
    """Probability that a colour image becomes grey."""
    grey_weights: tuple[float, float, float] = (float(3 * LUMA[0]), float(3 * LUMA[1]), float(3 * LUMA[2]))
    """How much red, green and blue then count, of mean 1."""
    grey_concentration: tuple[float, float, float] | None = None
    """Where given, these weights are drawn from a Dirichlet distribution instead, of such concentrations."""
    tinted_grey: bool = False
    """Grey images get a white balance too, and three channels: as single-image networks take them."""
    saturation: Distribution | None = None
    """Factor on the colours' distance from grey."""
    exposure: Distribution | None = None
    """Factor on the light. Light beyond white is lost."""
    white_balance: Distribution | None = None
    """Factor on each channel's light."""
    gamma: Distribution | None = None
    """Exponent of the tone curve, from light to level."""
    gain: Distribution | None = None
    """Factor on the level, after the tone curve."""
    channel_gain: Distribution | None = None
    """The same for each channel of a colour image."""
    extreme: float = 0.0
    """Probability of a gain that makes the image far too bright or far too dark."""
    contrast: Distribution | None = None
    """Factor on the level's distance from the pivot."""
    pivot: float = 0.5
    """The level that contrast does not change."""
    black: Distribution | None = None
    """What is added to all levels."""
    clipped: bool = True
    """See CameraResponse."""
    blur_px: Effect | None = None
    """Deviation of the Gaussian of an image out of focus."""
    vignette: Effect | None = None
    """Share of the light lost in the corners."""
    noise: Effect | None = None
    """Deviation of the noise, a level."""
    colour_noise: bool = False
    """Each channel has a noise of its own."""
    grain_px: Effect | None = None
    """Size of the noise's grains."""
    quality: Effect | None = None
    """Of JPEG, 1 to 100; the fraction is cut off."""
    rounding: float = 0.5
    """See CameraResponse."""

    def __post_init__(self) -> None:
        for name in ("grey", "extreme"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"augmentation: {name} is {getattr(self, name)}, expected a probability from 0 to 1")
        if abs(np.mean(self.grey_weights) - 1) > 1e-6:
            raise ValueError(f"augmentation: grey_weights are {self.grey_weights}, expected a mean of 1")


@dataclass(frozen=True)
class Difference:
    """How one camera of a pair differs from what both have in common: ranges of factors."""

    gain: Distribution
    channel_gain: Distribution
    gamma: Distribution
    contrast: Distribution
    blur_px: Distribution = field(default_factory=lambda: LogNormal(1, 0.2))
    vignette: Distribution = field(default_factory=lambda: Uniform(0.8, 1.2))
    noise: Distribution = field(default_factory=lambda: LogNormal(1, 0.1))


@dataclass(frozen=True)
class PairAugmentation:
    """Ranges of the photometric augmentation of a pair: most is common to both views, a little is each one's own."""

    common: Augmentation
    apart: Difference
    """How a pair's cameras mostly differ."""
    far_apart: Difference
    """How they differ where they differ much."""
    differing: float
    """Probability of the latter."""
    own_focus: float
    """Probability that each view is in or out of focus on its own."""
    black: Distribution
    """What is added to all levels of a view."""

    def __post_init__(self) -> None:
        for name in ("differing", "own_focus"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"pair augmentation: {name} is {getattr(self, name)}, expected 0 to 1")


SINGLE_IMAGE = Augmentation(
    grey=0.15,
    grey_weights=(1.0, 1.0, 1.0),
    tinted_grey=True,
    exposure=Uniform(0.6, 1.5),
    white_balance=Normal(1, 0.06),
    gamma=Uniform(0.75, 1.3),
    contrast=Uniform(0.8, 1.25),
    pivot=0.4,
    clipped=False,
    blur_px=Effect(0.3, Uniform(0.4, 1.1)),
    noise=Effect(1, Uniform(0, 0.025)),
    rounding=0.0,
)
"""For networks that see one image: depth from it, and completion."""


def augment(image: Image, rng: np.random.Generator, config: Augmentation = SINGLE_IMAGE) -> Image:
    """Return an image (h, w, 3) or (h, w) as another camera would show it."""
    light = to_light(as_rgb(image) if config.tinted_grey else image)
    return draw(rng, config, light.shape[2]).shoot(light, rng)


def augment_pair(left: Image, right: Image, rng: np.random.Generator, config: PairAugmentation) -> tuple[Image, Image]:
    """Return both views of a pair as two other cameras, much alike, would show them."""
    lights = to_light(left), to_light(right)
    first, second = draw_pair(rng, config, lights[0].shape[2])
    return first.shoot(lights[0], rng), second.shoot(lights[1], rng)


def to_light(image: Image, linear: float = 1.0) -> Floats:
    """Turn an 8-bit image into light (h, w, channels) from 0 to 1; `linear` is the exponent from level to light."""
    level = image.astype(np.float32) / np.float32(255)
    light = level if linear == 1 else np.power(level, np.float32(linear))
    return light if image.ndim == 3 else light[..., None]


def draw(rng: np.random.Generator, config: Augmentation, channels: int) -> CameraResponse:
    """Draw a camera's response to images of one or three channels."""
    grey_weights = _draw_grey(rng, config) if channels == 3 else None
    tints = 3 if channels == 3 and (grey_weights is None or config.tinted_grey) else 0
    saturation = _value(rng, config.saturation) if tints else 1.0
    light_gain = _gains(rng, config.exposure, config.white_balance, tints)
    gamma = _value(rng, config.gamma)
    level_gain = _gains(rng, config.gain, config.channel_gain, tints)
    if config.extreme and rng.random() < config.extreme:
        extreme = EXTREME_BRIGHT if rng.random() < 0.5 else EXTREME_DARK
        level_gain = _gains(rng, extreme, config.channel_gain, tints)
    return CameraResponse(
        grey_weights=grey_weights,
        saturation=saturation,
        light_gain=light_gain,
        gamma=gamma,
        level_gain=level_gain,
        contrast=_value(rng, config.contrast),
        pivot=config.pivot,
        black=_value(rng, config.black, absent=0.0),
        clipped=config.clipped,
        blur_px=_strength(rng, config.blur_px),
        vignette=_strength(rng, config.vignette),
        noise=_strength(rng, config.noise),
        colour_noise=config.colour_noise,
        grain_px=_strength(rng, config.grain_px),
        quality=int(_strength(rng, config.quality)),
        rounding=config.rounding,
    )


def draw_pair(
    rng: np.random.Generator, config: PairAugmentation, channels: int
) -> tuple[CameraResponse, CameraResponse]:
    """Draw the responses of a pair's two cameras."""
    common = draw(rng, replace(config.common, blur_px=None), channels)
    difference = config.far_apart if rng.random() < config.differing else config.apart
    responses = [_differ(rng, common, difference) for _ in range(2)]
    blurs_px = _draw_focus(rng, config)
    first, second = (
        replace(response, blur_px=blur_px * _value(rng, difference.blur_px), black=_value(rng, config.black))
        for response, blur_px in zip(responses, blurs_px, strict=True)
    )
    return first, second


def _differ(rng: np.random.Generator, common: CameraResponse, difference: Difference) -> CameraResponse:
    """Draw what is one camera's own."""
    tints = len(common.level_gain) if len(common.level_gain) > 1 else 0
    gains = _gains(rng, difference.gain, difference.channel_gain, tints)
    return replace(
        common,
        level_gain=tuple(a * b for a, b in zip(common.level_gain, gains, strict=True)),
        gamma=common.gamma * _value(rng, difference.gamma),
        contrast=common.contrast * _value(rng, difference.contrast),
        vignette=common.vignette * _value(rng, difference.vignette),
        noise=common.noise * _value(rng, difference.noise),
    )


def _draw_focus(rng: np.random.Generator, config: PairAugmentation) -> tuple[float, float]:
    """Draw the blur of both views, pixels: the same if it is there, but each view may have it on its own."""
    blur = config.common.blur_px
    if blur is None:
        return 0.0, 0.0
    strength_px = _value(rng, blur.strength)
    own = rng.random() < config.own_focus
    first, second = rng.random(2) < blur.probability if own else [rng.random() < blur.probability] * 2
    return strength_px * first, strength_px * second


def _draw_grey(rng: np.random.Generator, config: Augmentation) -> tuple[float, ...] | None:
    """Draw the weights of the channels in a grey image; None: it stays coloured."""
    if not config.grey or rng.random() >= config.grey:
        return None
    if config.grey_concentration is None:
        return config.grey_weights
    return tuple(3 * rng.dirichlet(config.grey_concentration))


def _gains(
    rng: np.random.Generator, all_: Distribution | None, each: Distribution | None, channels: int
) -> tuple[float, ...]:
    """Draw a factor for all channels, times one for each of so many; for none it is one factor."""
    gain = _value(rng, all_)
    return (gain,) if each is None or not channels else tuple(gain * each.draw(rng, channels))


def _value(rng: np.random.Generator, distribution: Distribution | None, absent: float = 1.0) -> float:
    return absent if distribution is None else float(distribution.draw(rng)[0])


def _strength(rng: np.random.Generator, effect: Effect | None) -> float:
    return 0.0 if effect is None else effect.draw(rng)
