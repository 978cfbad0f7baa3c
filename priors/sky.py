"""Sky mask from the image alone: a small network, the colours around, and a filter along the image's own edges.

1. The image is averaged to at most 60,000 pixels and made as bright as day.
2. The network (kernels/sky_net.py) says at half that size how sure it is of sky. It knows walls, trees and clouds by
   what they look like, not by their colour alone.
3. Thin things before the sky (poles, wires, branches) are too small for it: what has not the colour of the sky
   around it, but that of what is no sky, is doubted.
4. At full resolution guided filters (He, Sun, "Fast Guided Filter", 2015) fit the answer to colours: in a wide window,
   so that sky between branches and at dusk is known by the sky around, and in a narrow one, so that the mask ends
   where things do.

The weights lie in weights/sky.npz; `python -m priors.learn.fit_sky` trained them, weights/sky.md says on what.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.types import Depth, FloatMap, Image, Mask

if TYPE_CHECKING:
    from priors.kernels.sky_net import Layers

VERSION = 3
"""Goes into the cache's key of maps that were cropped by the mask: raise it when the mask changes."""
MOST_PIXELS = 60_000
"""Most pixels that the network sees."""
DARKEST = 0.2
"""A darker bright end is taken for this: a black image stays black."""
BIAS = np.float32(1)
"""Added to the network's logits: on recordings left out it misses more sky than it invents."""
AROUND = 15
"""Side of the window, blocks, whose colours a block is compared with."""
COLOUR_DEVIATION, USUAL_DISTANCE = 0.1, 0.2
"""Deviation of a surface's colour, and what distance to another one is taken for usual where there is none around."""
MOST_DOUBT, LEAST_SHARE = 6, 0.05
"""Largest doubt, a logit; share of a window below which the colour of its sky, or of its rest, counts less."""
GUIDES = ((5, 1 / 3), (31, 2 / 3))
"""Sides of the guided filters' windows, blocks, and their shares of the answer."""
WEIGHTS = Path(__file__).parent / "weights" / "sky.npz"
SATURATED = np.float32(12)
"""Largest logit beyond which more makes no difference."""

Floats = npt.NDArray[np.float32]


def sky_mask(image: Image) -> Mask:
    """Tell which pixels are sky, from the image alone.

    Args:
        image: (height, width, 3) RGB or (height, width) grey, uint8.

    Returns:
        (height, width), True where there is sky.
    """
    return find_sky(image, load_weights())


def find_sky(image: Image, layers: "Layers") -> Mask:
    """Tell by given weights which pixels (height, width) of an image are sky."""
    from priors.kernels import sky as kernels
    from priors.kernels.sky_net import forward

    if image.size == 0:
        return np.zeros(image.shape[:2], dtype=np.bool_)
    image = np.ascontiguousarray(as_rgb(image))
    side = pixel_side(image.shape[0], image.shape[1])
    logit = forward(brighten(kernels.shrink(image, side)), layers) + BIAS
    colour = kernels.shrink(image, 2 * side)
    target = sigmoid(logit - doubt_of_colour(brighten(colour), sigmoid(logit)))
    return kernels.apply_linear(image, guided_model(colour, target), 2 * side)


def doubt(depth: Depth, sky: Mask) -> Depth:
    """Return a depth map whose confidences are 0 in the sky (height, width); what it says of depth there stays."""
    if depth.confidence is None:
        return depth
    relative = depth.within_5_percent
    return replace(
        depth,
        confidence=np.where(sky, np.float32(0), depth.confidence),
        within_5_percent=None if relative is None else np.where(sky, np.float32(0), relative),
    )


def rows_below(sky: Mask, margin: int = 16) -> slice:
    """Return the rows to match: all but those at the top that hold sky only, a few of them kept."""
    ground = np.flatnonzero(~sky.all(axis=1))
    return slice(max(0, int(ground[0]) - margin) if ground.size else 0, sky.shape[0])


def pixel_side(height: int, width: int) -> int:
    """Return the side of the image's squares that are one pixel to the network."""
    return max(1, int(np.ceil(np.sqrt(height * width / MOST_PIXELS))))


def shrink_to_see(image: Image) -> Floats:
    """Average an image (height, width[, 3]) to what the network sees: (rows, columns, 3) in [0, 1] or above."""
    from priors.kernels.sky import shrink

    image = np.ascontiguousarray(as_rgb(image))
    return brighten(shrink(image, pixel_side(image.shape[0], image.shape[1])))


def brighten(colour: Floats) -> Floats:
    """Scale colours (height, width, 3) in [0, 1] so that the bright end is about 1: dusk looks like day."""
    green = colour[::2, ::2, 1]
    return colour / np.float32(np.clip(np.quantile(green, 0.98), DARKEST, 1))


@cache
def load_weights() -> "Layers":
    """Load the network's layers."""
    return read_weights(WEIGHTS)


def read_weights(path: Path) -> "Layers":
    """Read layers: arrays name.w and name.b, float16 in the file."""
    with np.load(path) as file:
        return pair_layers({name: np.ascontiguousarray(file[name], np.float32) for name in file.files})


def pair_layers(arrays: dict[str, Floats]) -> "Layers":
    """Pair each name.w with its name.b."""
    return {name[:-2]: (arrays[name], arrays[f"{name[:-2]}.b"]) for name in arrays if name.endswith(".w")}


def sigmoid(logit: FloatMap) -> FloatMap:
    """Turn logits into probabilities."""
    return np.float32(1) / (np.float32(1) + np.exp(-np.clip(logit, -SATURATED, SATURATED)))


def doubt_of_colour(colour: Floats, sky: FloatMap) -> FloatMap:
    """Return how much less each block looks like the sky around it than like the rest around it: a logit, 0 or more.

    Log likelihoods of two Gaussians around the local means, cut to 0 .. MOST_DOUBT: looks alone make nothing sky, since
    white walls look like it.

    Args:
        colour: (height, width, 3), brightened.
        sky: (height, width) probability of sky.
    """
    to_sky, to_rest = (distance_to(colour, weight * weight) for weight in (sky, 1 - sky))
    return np.clip((to_sky - to_rest) / np.float32(2 * COLOUR_DEVIATION**2), 0, MOST_DOUBT)


def distance_to(colour: Floats, weight: FloatMap) -> FloatMap:
    """Return the squared distance of each block's colour to the weighted mean around it."""
    share = blur(weight, AROUND)
    mean = blur(colour * weight[..., None], AROUND) / (share[..., None] + np.float32(1e-6))
    trust = np.minimum(share / np.float32(LEAST_SHARE), 1)
    red, green, blue = np.moveaxis(colour - mean, 2, 0)
    return trust * (red * red + green * green + blue * blue) + (1 - trust) * np.float32(USUAL_DISTANCE**2)


def guided_model(colour: Floats, target: FloatMap, smoothing: float = 1e-3) -> Floats:
    """Fit target = a . colour + b around each block, average the fits, then those of GUIDES' windows.

    Returns (height, width, 4), a then b.
    """
    from priors.kernels.sky import fit_linear

    red, green, blue = colour[..., 0], colour[..., 1], colour[..., 2]
    squares = red * red, red * green, red * blue, green * green, green * blue, blue * blue
    moments = red, green, blue, target, *squares, red * target, green * target, blue * target
    model = np.zeros((*target.shape, 4), np.float32)
    for side, share in GUIDES:
        means = np.stack([blur(moment, side) for moment in moments])
        model += np.float32(share) * blur(fit_linear(means, smoothing), side)
    return model


def blur(values: Floats, side: int) -> Floats:
    """Average over a window of side x side blocks."""
    return np.asarray(cv2.blur(values, (side, side)), dtype=np.float32)
