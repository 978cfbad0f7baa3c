"""Single-image depth of a frame: what a network says, aligned, with a confidence."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from priors.codecs import FARTHEST_M
from priors.error_model import WITHIN, chance_of
from priors.methods._mono_align import Aligner
from priors.methods._reference import ReferenceDepth
from priors.recalibration import BELIEVED, Recalibration
from priors.types import Camera, Depth, Drive, FloatMap, Frame, Image

MOST_ALIGNED = 12
"""Frames that one line for the drive is fitted to, at most."""
TOLERANCE_M = 1.0
"""The confidence is the probability of an error below it."""


class Prediction(NamedTuple):
    """What a network says of an image."""

    values: FloatMap
    """(height, width) depth, in metres or of unknown scale, or disparity; 0 = none."""
    log_error: FloatMap | None
    """(height, width) expected error of the depth's logarithm; None where the network does not tell."""


Predict = Callable[[Image, Camera], Prediction]
Align = Callable[[FloatMap, Frame], FloatMap]
"""Values (height, width) of a frame -> metres."""


@dataclass(frozen=True)
class Estimator:
    """Makes a frame's depth by a network."""

    predict: Predict
    align: Align = lambda values, frame: values
    """Default: the values are metres."""
    recalibration: Recalibration = BELIEVED
    """Mends the confidences; default: they are believed."""

    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis."""
        prediction = self.predict(frame.image(), frame.camera)
        depth_m = np.minimum(self.align(prediction.values, frame), np.float32(FARTHEST_M))
        if prediction.log_error is None:
            return Depth(depth_m)
        with np.errstate(divide="ignore"):
            right = -np.expm1(-np.float32(TOLERANCE_M) / (depth_m * prediction.log_error))
        relative = chance_of(depth_m, prediction.log_error, WITHIN)
        trust = np.where(depth_m > 0, right, np.float32(0)).astype(np.float32)
        return self.recalibration(Depth(depth_m, trust, within_5_percent=relative))


def by_frame(aligner: Aligner, reference: ReferenceDepth) -> Align:
    """Align each frame to its own reference depth."""

    def align(values: FloatMap, frame: Frame) -> FloatMap:
        line = aligner.fit([values], [reference(frame)], f"frame {frame.id}")
        return aligner.apply(line, values)

    return align


def by_drive(
    aligner: Aligner,
    reference: ReferenceDepth,
    predict: Predict,
    drive: Drive,
    indices: list[int],
    on_note: Callable[[str], None],
) -> Align:
    """Align every frame by one line, fitted to some of these frames of the drive."""
    from priors.adapt.training_frames import MOST_VIEWS, pick_evenly

    few = pick_evenly(indices, MOST_VIEWS)
    frames = [drive[index] for index in few[:: max(1, len(few) // MOST_ALIGNED)]]
    values = [predict(frame.image(), frame.camera).values for frame in frames]
    known_m = [reference(frame) for frame in frames]
    line = aligner.fit(values, known_m, f"{drive.name}, {len(frames)} frames")
    on_note(f"mono: one line for the drive, in {line.space}: scale {line.scale:.4g}, shift {line.shift:.4g}")
    return lambda values, frame: aligner.apply(line, values)
