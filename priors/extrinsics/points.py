"""Points of a sweep as a camera sees them while the LiDAR is turned and its clock is moved."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from priors.extrinsics.correction import Correction
from priors.geometry import transform, untwist
from priors.types import Camera, Mask, Matrix, Sweep

Floats = npt.NDArray[np.float64]
Xyz = npt.NDArray[np.floating]
NEAREST_M = 2.0
"""Points that are nearer hit the car itself."""
AROUND = 0.05
"""Share of the image's width."""


@dataclass(frozen=True)
class Points:
    """Points around the LiDAR, along the camera's axes as calibrated, and how they move while time passes."""

    xyz_m: Floats
    """(n, 3) from the LiDAR."""
    rate_m_s: Floats
    """(n, 3) how they move by a later clock; 0 where the drive does not know its motion."""
    origin_m: Floats
    """(3,) where the LiDAR is, from the camera."""

    @classmethod
    def of_sweep(cls, sweep: Sweep, T_cam_lidar: Matrix) -> "Points":
        """Untwist a sweep, or points that were made of it."""
        xyz_m = untwist(sweep).astype(np.float64)
        rate_m_s = np.zeros_like(xyz_m)
        if sweep.velocity is not None:
            rate_m_s = sweep.velocity[:3] + np.cross(sweep.velocity[3:], xyz_m)
        R = T_cam_lidar[:3, :3]
        return cls(xyz_m @ R.T, rate_m_s @ R.T, T_cam_lidar[:3, 3].copy())

    def __len__(self) -> int:
        return len(self.xyz_m)

    def take(self, which: Mask | npt.NDArray[np.int64]) -> "Points":
        """Return some of the points."""
        return Points(self.xyz_m[which], self.rate_m_s[which], self.origin_m)

    def placed(self, by: Correction) -> Floats:
        """Return where they are in the camera's frame (n, 3), metres."""
        return (self.xyz_m + by.delay_s * self.rate_m_s) @ by.R.T + self.origin_m + np.array(by.moved_m)


def crop(sweep: Sweep, camera: Camera, T_cam_lidar: Matrix) -> Sweep:
    """Return the points of a sweep that fall into an image, or near it: the motion within a sweep may bring them in."""
    xyz_m = transform(T_cam_lidar, sweep.xyz_m)
    seen = in_view(camera, xyz_m, -AROUND * camera.size[1])
    time_s = None if sweep.time_s is None else sweep.time_s[seen]
    return replace(sweep, xyz_m=np.ascontiguousarray(sweep.xyz_m[seen]), time_s=time_s)


def in_view(camera: Camera, xyz_m: Xyz, margin_px: float = 0.0) -> Mask:
    """Tell which points (n, 3), metres, fall into an image, at least so far from its border."""
    height, width = camera.size
    z = np.maximum(xyz_m[:, 2], 1e-6)
    u = camera.K[0, 0] * xyz_m[:, 0] / z + camera.K[0, 2]
    v = camera.K[1, 1] * xyz_m[:, 1] / z + camera.K[1, 2]
    inside = (u >= margin_px) & (u <= width - 1 - margin_px) & (v >= margin_px) & (v <= height - 1 - margin_px)
    return np.asarray(inside & (xyz_m[:, 2] > NEAREST_M))
