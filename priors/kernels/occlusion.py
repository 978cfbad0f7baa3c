"""Occlusions of a left view's disparity map: found, and filled from the background."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled

Map = npt.NDArray[np.float32]


@compiled
def fill_occlusions(
    disparity_px: Map, step_px: float, widest: float, margin_px: float, occluded: float
) -> tuple[Map, Map]:
    """Fill holes (0) of a left view that a foreground's shift explains: background on the left, a step up on the right.

    A foreground hides as many columns of the background, left of its outline, as their disparities differ by.

    Args:
        disparity_px: (height, width) px, 0 = none.
        step_px: smallest step from background to foreground.
        widest: widest hole, in steps, beside margin_px.
        margin_px: how much wider it may be.
        occluded: evidence of the values filled in.

    Returns:
        disparity_px (height, width) and evidence: 1 where it was matched, `occluded` where filled, else 0.
    """
    height, width = disparity_px.shape
    filled_px = disparity_px.copy()
    evidence = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        last = -1  # the last matched column
        for x in range(width):
            if disparity_px[y, x] <= 0:
                continue
            evidence[y, x] = 1
            if 0 <= last < x - 1:
                rise = disparity_px[y, x] - disparity_px[y, last]
                if rise > step_px and x - last - 1 <= widest * rise + margin_px:
                    filled_px[y, last + 1 : x] = disparity_px[y, last]
                    evidence[y, last + 1 : x] = occluded
            last = x
    return filled_px, evidence
