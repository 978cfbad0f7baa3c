"""The slow obvious versions of priors.extrinsics."""

import math

import numpy as np


def outline_sources(xyz_m: np.ndarray, side: int, step_deg: float) -> list[int]:
    """Which points are the last echo before a jump, by looking at all points for each: side 1 is right, -1 left."""
    count = len(xyz_m)
    azimuth = [math.degrees(math.atan2(y, x)) for x, y, _ in xyz_m.tolist()]
    range_m = [math.sqrt(x * x + y * y + z * z) for x, y, z in xyz_m.tolist()]
    elevation = [math.degrees(math.asin(xyz_m[n, 2] / range_m[n])) for n in range(count)]

    def next_echo(n: int, towards: int) -> int | None:
        for steps in (1, 2, 3, 4):
            wanted = azimuth[n] - towards * steps * step_deg
            far = [math.hypot(azimuth[k] - wanted, 3 * (elevation[k] - elevation[n])) for k in range(count)]
            best = min(range(count), key=lambda k: far[k])
            if far[best] < 0.6 * step_deg and best != n:
                return best
        return None

    found = []
    for n in range(count):
        ahead, behind = next_echo(n, side), next_echo(n, -side)
        if ahead is None:
            continue
        fall = 0.0
        if behind is not None:
            apart = max(abs(azimuth[n] - azimuth[behind]), 0.05)
            fall = min(0.0, (1 / range_m[n] - 1 / range_m[behind]) / apart)
        expected = 1 / range_m[n] + fall * abs(azimuth[ahead] - azimuth[n])
        jumps = range_m[ahead] > 1.12 * range_m[n] + 0.4
        if jumps and 1 / range_m[ahead] < expected - 0.1 / range_m[n]:
            found.append(n)
    return found


def seen_at(
    point_m: np.ndarray, R: np.ndarray, T_cam_lidar: np.ndarray, velocity: np.ndarray, time_s: float, K: np.ndarray
) -> tuple[float, float, float]:
    """Column, row and depth of one point, measured so long after the reference time by a turned LiDAR, step by step."""
    for _ in range(100):  # Euler's steps along the twist
        point_m = point_m + time_s / 100 * (velocity[:3] + np.cross(velocity[3:], point_m))
    x, y, z = R @ (T_cam_lidar[:3, :3] @ point_m) + T_cam_lidar[:3, 3]
    u, v, w = K @ np.array([x, y, z])
    return u / w, v / w, z
