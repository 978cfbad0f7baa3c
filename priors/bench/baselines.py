"""Baselines: what needs no package of ours. OpenCV's semi-global matcher, and completion by morphology alone."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import FARTHEST_M, as_grey
from priors.errors import expect_between
from priors.geometry import convert_disparity
from priors.methods.stereo import Stereo
from priors.pairs.matching import RANGE_STEP_PX, halve
from priors.pairs.read import baseline, read_pair
from priors.pairs.rectification import RectificationError
from priors.types import Depth, FloatMap, Frame, Image, Input, Method

MOST_HALVINGS = 3
SEARCHED = 192 / 1242
"""Disparities as a share of the image's width."""
DIAMOND = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
DIAMOND_5 = cv2.dilate(np.pad(DIAMOND, 1), DIAMOND)
FAR_M, LEAST_M = 100.0, 0.1
"""Depths are turned into closeness, FAR_M - depth; what is nearer than LEAST_M is no sample (the recipe's numbers)."""


@dataclass(frozen=True)
class Sgbm(Method):
    """OpenCV's 3-way semi-global matching of the grey pair; what it leaves out is left out.

    The disparities are corrected by what our own stereo measures of the pair (docs/methods/stereo.md), so that both
    have the same calibration.
    """

    VERSION: ClassVar[int] = 1
    halvings: int = 0
    """How often the pair is halved first; the result is put back to full size."""
    max_disparity_px: int | None = None
    """Disparities searched at full size; default: 192 of KITTI's width, as many of another."""
    offset_px: tuple[float, ...] | None = None
    """As stereo has it; default: measured."""
    scale: float | None = None

    def __post_init__(self) -> None:
        expect_between(0, self.halvings, MOST_HALVINGS, "halvings")

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("image", "other")

    def resolve(self, frame: Frame) -> Self:
        """Return it with the disparities of this width, and the pair's correction measured."""
        most_px = max(RANGE_STEP_PX, round(SEARCHED * frame.camera.size[1] / RANGE_STEP_PX) * RANGE_STEP_PX)
        sized = replace(self, max_disparity_px=self.max_disparity_px or most_px)
        if self.offset_px is not None:
            return sized
        error = Stereo().resolve(frame).rectification
        return replace(sized, offset_px=error.offset_px, scale=error.scale)

    def __call__(self, frame: Frame) -> Depth:
        """Make the map (height, width), metres; no confidence. DataError where the frame has no pair."""
        pair, fx_baseline = read_pair(frame), frame.camera.fx * baseline(frame)
        left, right = as_grey(pair.left), as_grey(pair.right)
        for _ in range(self.halvings):
            left, right = halve(left), halve(right)
        factor = 2**self.halvings
        assert self.max_disparity_px is not None
        matched_px = factor * self._match(left, right, self.max_disparity_px // factor)
        if factor > 1:
            size = (matched_px.shape[1] * factor, matched_px.shape[0] * factor)
            matched_px = np.asarray(cv2.resize(matched_px, size, interpolation=cv2.INTER_NEAREST))
        height, width = frame.camera.size
        return Depth(self._depth(pair.restore(matched_px[:height, :width]), frame, fx_baseline))

    def _match(self, left: Image, right: Image, count: int) -> FloatMap:
        """Return the disparity (height, width), px; 0 = none."""
        count = -(-count // RANGE_STEP_PX) * RANGE_STEP_PX
        count = min(count, (left.shape[1] - 1) // RANGE_STEP_PX * RANGE_STEP_PX)  # OpenCV refuses more
        if count == 0:
            return np.zeros(left.shape, np.float32)
        mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
        matcher = cv2.StereoSGBM.create(0, count, 3, 72, 288, 1, 63, 10, 100, 2, mode)
        return np.maximum(matcher.compute(left, right).astype(np.float32) / 16, 0)

    def _depth(self, matched_px: FloatMap, frame: Frame, fx_baseline: float) -> FloatMap:
        shift, tilt, yaw, pitch = (*(self.offset_px or ()), 0.0, 0.0, 0.0, 0.0)[:4]
        error = RectificationError(shift, tilt, yaw, pitch, 1.0 if self.scale is None else self.scale)
        least_px = np.float32(fx_baseline / FARTHEST_M)
        corrected_px = np.maximum(error.correct(matched_px, frame.camera), least_px)
        disparity_px = np.where(matched_px > 0, corrected_px, np.float32(0))
        return convert_disparity(disparity_px, frame.camera.fx, baseline(frame))


@dataclass(frozen=True)
class Recipe(Method):
    """Complete the data set's sparse map by morphology alone, near surfaces first.

    IP-Basic: Ku, Harakeh, Waslander, "In Defense of Classical Image Processing", 2018. It needs no image.
    """

    VERSION: ClassVar[int] = 1

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("sparse",)

    def resolve(self, frame: Frame) -> Self:
        """Return it as it is: nothing is 'auto'."""
        return self

    def __call__(self, frame: Frame) -> Depth:
        """Make the dense map (height, width), metres; no confidence."""
        return Depth(fill(frame.sparse().depth_m))


def fill(sparse_m: FloatMap) -> FloatMap:
    """Fill a sparse map (height, width), metres, 0 = none, by IP-Basic's steps; 0 where nothing is near."""
    closeness = np.where(sparse_m > LEAST_M, FAR_M - sparse_m, 0).astype(np.float32)
    closeness = np.asarray(cv2.dilate(closeness, DIAMOND_5))
    closeness = np.asarray(cv2.morphologyEx(closeness, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)))
    closeness = _where_empty(closeness, 7)
    closeness = _where_empty(_to_the_top(closeness), 31)
    closeness = np.asarray(cv2.medianBlur(closeness, 5))
    closeness = np.where(closeness > LEAST_M, cv2.GaussianBlur(closeness, (5, 5), 0), closeness)
    return np.where(closeness > LEAST_M, FAR_M - closeness, 0).astype(np.float32)


def _where_empty(closeness: npt.NDArray[np.float32], side: int) -> npt.NDArray[np.float32]:
    """Dilate into what is empty alone."""
    dilated = cv2.dilate(closeness, np.ones((side, side), np.uint8))
    return np.where(closeness > LEAST_M, closeness, dilated).astype(np.float32)


def _to_the_top(closeness: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Let each column's uppermost value stand up to the image's top."""
    first = np.argmax(closeness > LEAST_M, axis=0)
    top = closeness[first, np.arange(closeness.shape[1])]
    above = np.arange(closeness.shape[0])[:, None] < first
    return np.where(above, top, closeness).astype(np.float32)
