"""Sky mask from the image alone: colour, position, texture, and what the image's own sky looks like.

Three steps, the first two on blocks of pixels (at most 20,000):
1. a small learned rule (one hidden layer) on colour relative to the image's own range, texture at four scales, height
   in the image, and the smoothest path to the top edge;
2. a second rule that also compares each block with what step 1 took for sky in this very image: colour histograms and
   local means, what lies above and below in the column, and the smoothest path to a sure block;
3. at full resolution a guided filter (He, Sun, "Fast Guided Filter", 2015) fits the blocks' answer to colour edges, so
   that poles and branches stay out of the sky.

The coefficients lie in weights/sky.npz; `python -m priors.learn.fit_sky` fitted them, weights/sky.md says on what.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.types import Depth, FloatMap, Image, Mask

VERSION = 1
"""Goes into the cache's key of maps that were cropped by the mask: raise it when the mask changes."""
MOST_BLOCKS = 20_000
"""Most blocks an image is averaged to."""
WEIGHTS = Path(__file__).parent / "weights" / "sky.npz"
NOISE = np.float32(4e-3)
"""One grey level: texture below it is sensor noise."""
SATURATED = np.float32(12)
"""Cost, and largest logit, beyond which more makes no difference."""
SLOPE, SLACK = 12.0, 0.03
"""Cost of a path through the image per unit of colour change, and the change from block to block that is free."""

Floats = npt.NDArray[np.float32]
Layers = tuple[tuple[Floats, Floats], ...]


def sky_mask(image: Image) -> Mask:
    """Tell which pixels are sky, from the image alone.

    Args:
        image: (height, width, 3) RGB or (height, width) grey, uint8.

    Returns:
        (height, width), True where there is sky.
    """
    return find_sky(image, load_weights())


def find_sky(image: Image, rules: "tuple[Layers, Layers]") -> Mask:
    """Tell by given rules which pixels (height, width) of an image are sky."""
    from priors.kernels import sky as kernels

    if image.size == 0:
        return np.zeros(image.shape[:2], dtype=np.bool_)
    image = np.ascontiguousarray(as_rgb(image))
    factor = block_side(image.shape[0], image.shape[1])
    colour, texture = kernels.shrink(image, factor)
    first, normalised = describe(colour, texture)
    logit = apply_layers(rules[0], first)
    logit = apply_layers(rules[1], compare(first, normalised, logit))
    return kernels.apply_linear(image, guided_model(colour, sigmoid(logit)), factor)


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


def block_side(height: int, width: int) -> int:
    """Return the side of the blocks an image is averaged to, pixels."""
    return max(1, int(np.ceil(np.sqrt(height * width / MOST_BLOCKS))))


@cache
def load_weights() -> tuple[Layers, Layers]:
    """Load the layers of the two rules."""
    with np.load(WEIGHTS) as file:
        first, second = (
            tuple((file[f"rule{rule}_w{layer}"], file[f"rule{rule}_b{layer}"]) for layer in (0, 1)) for rule in (1, 2)
        )
    return first, second


def apply_layers(layers: Layers, values: Floats) -> FloatMap:
    """Run dense layers (ReLU between them) on n values per block, (n, ...): logits (...)."""
    from priors.kernels.sky import dense

    shape = values.shape[1:]
    values = np.ascontiguousarray(values.reshape(len(values), -1), np.float32)
    for number, (weights, bias) in enumerate(layers):
        if number:
            np.maximum(values, 0, out=values)
        answer = np.empty((bias.size, values.shape[1]), np.float32)
        dense(values, weights.reshape(len(values), -1), bias.reshape(-1), answer)
        values = answer
    return values.reshape(shape)


def sigmoid(logit: FloatMap) -> FloatMap:
    """Turn logits into probabilities."""
    return np.float32(1) / (np.float32(1) + np.exp(-np.clip(logit, -SATURATED, SATURATED)))


def describe(colour: Floats, texture: FloatMap) -> tuple[Floats, Floats]:
    """Describe each block by its colour, texture and place.

    Args:
        colour: (height, width, 3) in [0, 1].
        texture: (height, width) standard deviation of grey inside the block.

    Returns:
        (19, height, width) values, and the colours (height, width, 3) scaled so that the image's bright end is 1:
        exposure drops out.
    """
    grey = np.float32(0.299) * colour[..., 0] + np.float32(0.587) * colour[..., 1] + np.float32(0.114) * colour[..., 2]
    gain = 1 / max(float(np.quantile(grey[::2, ::2], 0.98)), 0.05)
    colour, grey, texture = colour * np.float32(gain), grey * np.float32(gain), texture * np.float32(gain)
    height, width = grey.shape
    ground = np.quantile(grey[int(0.55 * height) :: 2, ::2], [0.5, 0.95]).astype(np.float32)
    top = np.quantile(grey[: max(2, height // 6), ::2], 0.9).astype(np.float32)
    code = np.minimum(grey * 240, 255).astype(np.uint8)
    rank = np.cumsum(np.bincount(code.ravel(), minlength=256), dtype=np.float32)[code] / np.float32(code.size)
    red, green, blue = colour[..., 0], colour[..., 1], colour[..., 2]
    bright, dark = np.maximum(np.maximum(red, green), blue), np.minimum(np.minimum(red, green), blue)
    edge = gradient(grey)
    deviation = np.sqrt(np.maximum(blur(grey * grey, 9) - blur(grey, 9) ** 2, 0))
    y = np.repeat(((np.arange(height, dtype=np.float32) + 0.5) / height)[:, None], width, axis=1)
    return np.stack(
        [
            grey,
            rank,
            grey - ground[0],
            grey - ground[1],
            (blue - red) / (bright + 0.1),
            (2 * green - red - blue) / (bright + 0.1),
            (bright - dark) / (bright + 0.1),
            log(edge),
            log(texture),
            log(blur(edge, 5)),
            log(blur(edge, 15)),
            log(deviation),
            y,
            y * y,
            np.log(path_from_top(colour) + 0.02),
            grey - np.minimum.accumulate(blur(grey, 3), axis=0),
            log(np.maximum.accumulate(blur(edge, 3), axis=0)),
            grey - mean_below(grey),
            grey - top,
        ]
    ).astype(np.float32, copy=False), colour


def compare(first: Floats, colour: Floats, logit: FloatMap) -> Floats:
    """Compare each block with what looks like sky, and like no sky, in this image.

    Args:
        first: (19, height, width) what `describe` gave.
        colour: (height, width, 3) its normalised colours.
        logit: (height, width) how sure the first rule is of sky.

    Returns:
        (33, height, width): 14 comparisons, then `first`.
    """
    from priors.kernels.sky import grow_all

    sky = sigmoid(logit)
    weights = sky * sky, (1 - sky) ** 2
    likelier = log_ratio(first[0], first[4], *weights)
    # The surest sky of the image starts free of charge, even where nothing is quite sure (dusk, grey cameras).
    surest = min(max(float(np.quantile(logit, 0.995)), 0.0), 4.0)
    starts = np.stack([np.clip(surest - logit, 0, SATURATED), np.clip(logit + 4, 0, SATURATED)]).astype(
        np.float32, copy=False
    )
    from_sky, from_rest = grow_all(starts, colour, SLOPE, SLACK)
    count = np.arange(1, sky.shape[0] + 1, dtype=np.float32)[:, None]
    evidence = [
        np.clip(logit, -SATURATED, SATURATED),
        sky,
        likelier,
        blur(likelier, 5),
        unlike(colour, weights[0]),
        unlike(colour, weights[1]),
        np.cumsum(sky, axis=0) / count,
        mean_below(sky),
        blur(sky, 15),
        blur(sky, 7),
        np.repeat(sky.mean(axis=1, keepdims=True), sky.shape[1], axis=1),
        from_sky,
        from_rest,
        np.log(from_sky + 0.1),
    ]
    return np.stack([*evidence, *first]).astype(np.float32, copy=False)


def path_from_top(colour: Floats) -> FloatMap:
    """Return the cost of the smoothest path from the top edge to each block."""
    from priors.kernels.sky import grow

    start = np.full(colour.shape[:2], np.float32(1e6))
    start[0] = 0
    return grow(start, colour, 1.0, 0.0)


def log_ratio(grey: FloatMap, chroma: FloatMap, sky: FloatMap, rest: FloatMap) -> FloatMap:
    """Return log(p(colour | sky) / p(colour | rest)) from weighted, smoothed histograms of the image itself."""
    shape = (32, 24)
    cell = np.clip((grey * 26).astype(np.int32), 0, shape[0] - 1) * shape[1]
    cell += np.clip(((chroma + 0.6) * 16).astype(np.int32), 0, shape[1] - 1)
    logs = []
    for weight in (sky, rest):
        flat = np.bincount(cell.ravel(), weight.ravel(), minlength=shape[0] * shape[1]).astype(np.float32)
        counts = np.asarray(cv2.GaussianBlur(flat.reshape(shape), (0, 0), 1))
        logs.append(np.log(counts / (counts.sum() + 30) + 4e-4))
    return (logs[0] - logs[1]).ravel()[cell]


def unlike(colour: Floats, weight: FloatMap) -> FloatMap:
    """Return the log distance of each block's colour to the weighted mean around it (or over the image)."""
    side = 3 * ((colour.shape[1] // 8) | 1)
    weighted = colour * weight[..., None]
    share = blur(weight, side) + 1e-3
    local = blur(weighted, side) / share[..., None]
    overall = weighted.sum(axis=(0, 1)) / (weight.sum() + 1e-3 * weight.size)
    trust = np.minimum(share / 0.02, 1)[..., None]
    red, green, blue = np.moveaxis(np.abs(colour - overall - trust * (local - overall)), 2, 0)
    distance = red + green + blue
    return np.log(distance + 0.02)


def guided_model(colour: Floats, target: FloatMap, side: int = 5, smoothing: float = 1e-3) -> Floats:
    """Fit target = a . colour + b around each block, then average the fits: (height, width, 4), a then b."""
    from priors.kernels.sky import fit_linear

    red, green, blue = colour[..., 0], colour[..., 1], colour[..., 2]
    squares = red * red, red * green, red * blue, green * green, green * blue, blue * blue
    moments = red, green, blue, target, *squares, red * target, green * target, blue * target
    return blur(fit_linear(np.stack([blur(moment, side) for moment in moments]), smoothing), side)


def gradient(grey: FloatMap) -> FloatMap:
    """Return the gradient's size, grey per block."""
    x = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    y = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return np.sqrt(x * x + y * y)


def blur(values: Floats, side: int) -> Floats:
    """Average over a window of side x side blocks."""
    return np.asarray(cv2.blur(values, (side, side)), dtype=np.float32)


def mean_below(values: FloatMap) -> FloatMap:
    """Average each column from the block itself down to the bottom."""
    count = np.arange(values.shape[0], 0, -1, dtype=np.float32)[:, None]
    return np.cumsum(values[::-1], axis=0)[::-1] / count


def log(texture: FloatMap) -> FloatMap:
    """Return the logarithm of a texture measure, flat below the noise."""
    return np.log(texture + NOISE)
