"""Whole surfaces: a value that frames contradict is kept where the surface that it lies on is trusted.

Of a right prior 5 to 10 % of the values are contradicted: at edges, far away, on what moves. A fit misses them: without
them AbsRel on KITTI drive 0009 was 0.095 for 0.070. But they go on smoothly into values that are not contradicted,
and gross errors do not: a value that is wrong by itself has no surface, and a part of the image that is wrong is one
apart from what is around it.
"""

import numpy as np
import numpy.typing as npt

from nerf.evidence.corrected import LEAST_TRUST
from nerf.kernels.cpu.surfaces import surfaces

SMOOTH = 1.1
"""Neighbours lie on one surface where the farther is less than so many times as far as the nearer."""
MOST = 0.5
"""Share of a surface's values, by their weight, that must be trusted for all of them to be."""

Floats = npt.NDArray[np.float32]
Trust = npt.NDArray[np.uint8]


def trusted_whole(inverse: Floats, trust: Trust, weight: Floats) -> Trust:
    """Return the trust of a map's values with that of whole surfaces: at least LEAST_TRUST where most is trusted.

    Args:
        inverse: (h, w) inverse depth, 1/m; not above 0: no value.
        trust: (h, w) trust x 255 of each value by itself.
        weight: (h, w) how much each value counts, [0, 1].
    """
    surface = surfaces(inverse, SMOOTH).ravel()
    counts = np.where(inverse > 0, weight, 0).ravel()
    whole = np.bincount(surface, counts, len(surface))
    agreed = np.bincount(surface, np.where(trust.ravel() >= LEAST_TRUST, counts, 0), len(surface))
    stands = ((agreed >= MOST * whole) & (whole > 0))[surface].reshape(trust.shape)
    return np.where(stands, np.maximum(trust, np.uint8(LEAST_TRUST)), trust)
