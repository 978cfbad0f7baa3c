"""Completion by a network: it mends what the classical method fills, with the image and the samples before it."""

from pathlib import Path

import numpy as np
import torch

from priors.nets import runtime
from priors.nets.fused import fuse
from priors.nets.runtime import Ready, Runtime
from priors.types import Depth, FloatMap, Image, Mask

WITHIN = 0.05
"""The confidence is the probability that the depth is right within this share of it."""
NEARER, FARTHER = np.float32(0.8), np.float32(1.25)
"""No value is nearer than the nearest sample, or farther than the farthest, by more than these factors."""
_fused: dict[int, Ready] = {}


def open_network(size: str, chosen: Runtime, file: Path | None) -> Ready:
    """Load the network, once a process; DataError where its weights are missing or damaged."""
    ready = runtime.open_net("mffnet", size, chosen, file)
    if chosen != "bf16":
        return ready
    if id(ready.net) not in _fused:
        _fused[id(ready.net)] = Ready(fuse(ready.net), ready.runtime, ready.about)
    return _fused[id(ready.net)]


def mend(ready: Ready, fill: Depth, sparse_m: FloatMap, image: Image, near: Mask) -> Depth:
    """Correct a filled map (height, width).

    Args:
        ready: the network.
        fill: metres, a value everywhere, with confidence.
        sparse_m: the samples it was filled from, metres, 0 = none; at least one.
        image: (height, width, 3) RGB or (height, width) grey, uint8.
        near: (height, width) where a value is wanted. Rows outside are left out before anything is computed.

    Returns:
        depth_m, and the confidence: the probability that it is right within 5 %; both 0 where no value is wanted.
    """
    depth_m, confidence = np.zeros((2, *near.shape), np.float32)
    wanted = np.flatnonzero(near.any(axis=1))
    rows = slice(int(wanted[0]), int(wanted[-1]) + 1)
    maps = (torch.from_numpy(np.ascontiguousarray(values[rows]))[None] for values in _maps(fill, sparse_m))
    found = ready(runtime.as_input(image[rows]), *maps)
    samples_m = sparse_m[sparse_m > 0]
    limits = float(samples_m.min() * NEARER), float(samples_m.max() * FARTHER)
    with torch.inference_mode():
        trust = -torch.expm1(-WITHIN * torch.exp(-found.log_scale))
        depth_m[rows] = runtime.as_map(found.depth_m.clamp(*limits))
        confidence[rows] = runtime.as_map(trust)
    depth_m *= near
    confidence *= near
    return Depth(depth_m, confidence)


def _maps(fill: Depth, sparse_m: FloatMap) -> tuple[FloatMap, FloatMap, FloatMap]:
    assert fill.confidence is not None
    return fill.depth_m, fill.confidence, sparse_m
