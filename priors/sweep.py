"""Untwist a LiDAR sweep: move every point to where it was at the sweep's reference time."""

import numpy as np
import numpy.typing as npt

from priors.types import Sweep


def untwist(sweep: Sweep) -> npt.NDArray[np.float32]:
    """Return the sweep's points (n, 3), metres, with the ego motion during the rotation taken out.

    Constant velocity: p(t_ref) = Exp(t * angular) p + t * linear. Where the motion is compensated already, or unknown,
    the points come back as they are.
    """
    if sweep.time_s is None or sweep.velocity is None:
        return sweep.xyz_m
    from priors.kernels.untwist import untwist_points

    return untwist_points(sweep.xyz_m, sweep.time_s, sweep.velocity)
