"""Completion by a network: it corrects what the classical method fills, with the image and the samples before it."""

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from priors.codecs import as_rgb
from priors.methods._completion_choice import DepthChoice
from priors.methods._completion_gate import DensityGate
from priors.nets.trunk import MULTIPLE
from priors.types import Depth, FloatMap, Image, Mask

if TYPE_CHECKING:  # onnxruntime's half is loaded where it is asked for
    from priors.nets.graphs import Portable
    from priors.nets.runtime import Ready

WITHIN = 0.05
"""The confidence is the probability that the depth is right within this share of it."""


class Looked(NamedTuple):
    """What the network says, in the rows that hold all that is wanted: (h, w) each."""

    rows: slice
    depth_m: FloatMap
    """The correction counts as the gate of the weights has it."""
    error: FloatMap
    """The expected error as a share of the depth."""


def look(net: "Ready | Portable", fill: Depth, sparse_m: FloatMap, image: Image, near: Mask) -> Looked:
    """Show a filled map (height, width) to the network; arguments as those of `correct`."""
    rows = span(near)
    kind = torch.bfloat16 if net.runtime == "bf16" else torch.float32
    colour = torch.from_numpy(_pad(as_rgb(image[rows]))).permute(2, 0, 1)[None].to(kind) / 255
    maps: list[Tensor] = [
        torch.from_numpy(_pad(values[rows]))[None] for values in (fill.depth_m, fill.trust(), sparse_m)
    ]
    out = net(colour, *maps)
    shares = DensityGate.of(net.about).shares(sparse_m, near)
    height, width = near[rows].shape
    with torch.inference_mode():
        mended = out.depth_m
        if shares is not None:
            mended = maps[0] * (mended.cpu() / maps[0]) ** torch.from_numpy(_pad(shares[rows]))[None]
        depth_m, error = (
            np.ascontiguousarray(value[0].cpu().numpy()[:height, :width]) for value in (mended, out.log_scale.exp())
        )
    return Looked(rows, depth_m, error)


def correct(
    net: "Ready | Portable",
    fill: Depth,
    sparse_m: FloatMap,
    image: Image,
    near: Mask,
    limits_m: tuple[float, float],
) -> Depth:
    """Correct a filled map (height, width).

    Args:
        net: the network.
        fill: metres, a value everywhere, with confidence.
        sparse_m: the samples it was filled from, metres, 0 = none; at least one.
        image: (height, width, 3) RGB or (height, width) grey, uint8.
        near: (height, width) where a value is wanted. Rows outside are left out before anything is computed.
        limits_m: the nearest and the farthest value that may come out.

    Returns:
        depth_m, and the confidence: the probability that it is right within 5 %; both 0 where no value is wanted.
    """
    rows, mended_m, error = look(net, fill, sparse_m, image, near)
    choice = DepthChoice.read(net.about)
    if choice is not None:
        maps = mended_m, fill.depth_m[rows], sparse_m[rows], error, fill.trust()[rows]
        mended_m = choice(maps, near[rows])
    depth_m, confidence = np.zeros((2, *near.shape), np.float32)
    np.multiply(np.clip(mended_m, *limits_m), near[rows], out=depth_m[rows])
    np.multiply(-np.expm1(-WITHIN / error), near[rows], out=confidence[rows])
    return Depth(depth_m, confidence, within_5_percent=confidence)


def span(near: Mask) -> slice:
    """Return the rows that hold all that is wanted, and more above, so that their number is a multiple of 32."""
    wanted = np.flatnonzero(near.any(axis=1))
    bottom = int(wanted[-1]) + 1
    count = -(-(bottom - int(wanted[0])) // MULTIPLE) * MULTIPLE
    return slice(max(0, bottom - count), bottom)


def _pad(values: np.ndarray) -> np.ndarray:
    """Repeat the right and bottom edges until both sizes are multiples of 32: cheaper here than in the network."""
    height, width = values.shape[:2]
    return np.asarray(cv2.copyMakeBorder(values, 0, -height % MULTIPLE, 0, -width % MULTIPLE, cv2.BORDER_REPLICATE))
