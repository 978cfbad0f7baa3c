"""The ground below a camera: how far a depth map says it is, and how far it is on a car."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from priors.check.sample import Sample
from priors.types import Camera, FloatMap

USUAL_M = 1.65
CAR_M = (0.7, 4.0)
"""How far the ground lies below a car's camera: usually, and at least and at most."""
SHARE = 0.9
"""So much of what lies below the camera is not below the ground."""
NEAR_M, NEAR_SHARE = 30.0, 0.33
"""What is farther is not looked at, unless it belongs to the nearest third: in other units near is another distance."""
FEWEST = 200


def ground_below(sampled: Sequence[Sample], what: str) -> float | None:
    """Return how far a kind of depth map says the ground lies below the camera, metres; None where few points are."""
    maps = [(sample.frame.camera, sample.depths[what]) for sample in sampled if what in sample.depths]
    below_m = np.concatenate([np.zeros(0), *(_below(camera, map_m) for camera, map_m in maps)])
    return float(np.quantile(below_m, SHARE)) if len(below_m) >= FEWEST else None


def _below(camera: Camera, depth_m: FloatMap) -> npt.NDArray[np.float64]:
    """Return how far the points of the image's lower half lie below the camera (n,), metres."""
    rows = np.arange(camera.size[0])[:, None]
    below_m = depth_m * ((rows - camera.K[1, 2]) / camera.K[1, 1])
    counted = (depth_m > 0) & (below_m > 0) & (rows > camera.size[0] // 2)
    if counted.any():
        counted &= depth_m <= max(NEAR_M, float(np.quantile(depth_m[counted], NEAR_SHARE)))
    return below_m[counted].astype(np.float64)
