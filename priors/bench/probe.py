"""Probes: three small pieces of work that stand for what methods do. How fast they are tells how fast a machine is.

The shipped table (shipped.json) holds the probes' times beside those of the methods, measured in turn on one machine.
On another machine the methods' times grow as the probes' do.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from statistics import median
from typing import ClassVar, Literal, Self, get_args

import cv2
import numpy as np

from priors.machine import cpu, threads
from priors.nets.speeds import FAST_BF16
from priors.sky import sky_mask
from priors.types import Depth, Frame, Image, Input, Method

Kind = Literal["matching", "kernels", "convolutions"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SIZE = (188, 620)
"""Of the probes' image: half of KITTI's."""
SHIFT_PX, DISPARITIES = 12, 96
CHANNELS, LAYERS = 64, 3
CALIBRATE_S = 2.0


@dataclass(frozen=True)
class Probe(Method):
    """A probe as an entrant of a bench, so that it takes turns with the methods; its map is empty."""

    VERSION: ClassVar[int] = 1
    kind: Kind = "matching"

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return that it reads nothing."""
        return ()

    def resolve(self, frame: Frame) -> Self:
        """Return it as it is."""
        return self

    def __call__(self, frame: Frame) -> Depth:
        """Do the work; the frame has no part in it."""
        work(self.kind)()
        return Depth(np.zeros(frame.camera.size, np.float32))


def work(kind: Kind) -> Callable[[], object]:
    """Return a probe's work, ready to be done: semi-global matching, our kernels (the sky mask), or convolutions."""
    if kind == "matching":
        left, right = _pair()
        matcher = cv2.StereoSGBM.create(0, DISPARITIES, 5, 200, 800, 1, 63, 15, 100, 1, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
        return lambda: matcher.compute(left, right)
    if kind == "kernels":
        image = np.repeat(_pair()[0][..., None], 3, axis=2)
        return lambda: sky_mask(image)
    return _convolve


def calibrate(seconds: float = CALIBRATE_S) -> dict[Kind, float]:
    """Return the probes' times on this machine, ms: medians of runs in turn, for about so long.

    What is compiled and loaded first is not counted.
    """
    works = {kind: work(kind) for kind in KINDS}
    took: dict[Kind, list[float]] = {kind: [] for kind in KINDS}
    with threads.limited(threads.count()):
        for each in works.values():
            each()
        began = time.perf_counter()
        while time.perf_counter() - began < seconds or not took[KINDS[-1]]:
            for kind, each in works.items():
                start = time.perf_counter()
                each()
                took[kind].append(1e3 * (time.perf_counter() - start))
    return {kind: median(values) for kind, values in took.items()}


@cache
def _pair() -> tuple[Image, Image]:
    """Return a textured grey pair, the same everywhere: a plane at SHIFT_PX."""
    drawn = np.random.default_rng(0).uniform(0, 255, (SIZE[0], SIZE[1] + SHIFT_PX)).astype(np.float32)
    smooth = cv2.normalize(cv2.GaussianBlur(drawn, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)  # type: ignore[call-overload]
    texture = np.asarray(smooth, np.uint8)
    return np.ascontiguousarray(texture[:, :-SHIFT_PX]), np.ascontiguousarray(texture[:, SHIFT_PX:])


def _convolve() -> object:
    """Convolve in the numbers that this kind of CPU is fast in."""
    import torch

    image, kernel = _tensors()
    with torch.inference_mode():
        for _ in range(LAYERS):
            image = torch.nn.functional.conv2d(image, kernel, padding=1).relu_()
    return image


@cache
def _tensors() -> "tuple[torch.Tensor, torch.Tensor]":  # type: ignore[name-defined]  # noqa: F821  imported late
    import torch

    dtype = torch.bfloat16 if cpu.mode() in FAST_BF16 else torch.float32
    image = torch.full((1, CHANNELS, SIZE[0] // 2, SIZE[1] // 2), 0.5, dtype=dtype)
    kernel = torch.full((CHANNELS, CHANNELS, 3, 3), 1 / (9 * CHANNELS), dtype=dtype)
    layout = {"memory_format": torch.channels_last}
    return image.to(**layout), kernel.to(**layout)  # type: ignore[call-overload]
