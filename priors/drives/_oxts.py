"""When an oxts record was taken, and when its frame was.

A KITTI frame keeps the nearest of the IMU's records, which come at 100 Hz: up to 5 ms lie between, 7 cm at 50 km/h,
and poses taken as they are step back and forth by that. The records' stamps tell: the scanner turns at a steady rate,
so the frames' own times lie on a line through them.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from priors.types import Matrix

AROUND = 10  # frames before and after through whose stamps the line goes: 21 leave 0.6 ms of the 5
FEWEST = 5
RECORD_S = 0.01  # stamps farther from the line are no rounding: then nothing is known about the frames' times


def late_s(stamps_s: Mapping[int, float]) -> dict[int, float]:
    """Return by frame how much later it was taken than its record was stamped, seconds, within ± RECORD_S.

    Frames whose stamps do not lie along a line, with the stamps around, are left out.
    """
    late = {}
    for number in stamps_s:
        around = [other for other in range(number - AROUND, number + AROUND + 1) if other in stamps_s]
        if len(around) < FEWEST:
            continue
        steps = np.array(around, dtype=np.float64) - number
        stamps = np.array([stamps_s[other] for other in around]) - stamps_s[number]
        rate, own = np.polyfit(steps, stamps, 1)
        if rate > 2 * RECORD_S and np.abs(stamps - (rate * steps + own)).max() <= RECORD_S:
            late[number] = float(own)
    return late


def between(T_world_a: Matrix, T_world_b: Matrix, share: float) -> Matrix:
    """Return the pose (4, 4) that lies `share` of the way from a to b: 0 is a, 1 is b, beyond goes on."""
    T = np.eye(4)
    turn = Rotation.from_matrix(T_world_a[:3, :3].T @ T_world_b[:3, :3]).as_rotvec()
    T[:3, :3] = T_world_a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    T[:3, 3] = (1 - share) * T_world_a[:3, 3] + share * T_world_b[:3, 3]
    return T
