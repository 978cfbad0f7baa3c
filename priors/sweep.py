"""Untwist a LiDAR sweep: move every point to where it was at the sweep's reference time."""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.types import Sweep


def untwist(sweep: Sweep) -> npt.NDArray[np.float32]:
    """Return the sweep's points (n, 3), metres, with the ego motion during the rotation taken out.

    Constant velocity: p(t_ref) = Exp(t * angular) p + t * linear. Where the motion is compensated already, or unknown,
    the points come back as they are.
    """
    if sweep.time_s is None or sweep.velocity is None:
        return sweep.xyz_m
    t = sweep.time_s[:, None]
    turned = Rotation.from_rotvec(t * sweep.velocity[3:]).apply(sweep.xyz_m)
    return (turned + t * sweep.velocity[:3]).astype(np.float32)
