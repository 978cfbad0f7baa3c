"""Scan lines of an HDL-64, and which pixels of a view they meet: sweeps of a scanner that drove on."""

import numpy as np
import numpy.typing as npt

from priors.geometry import invert, rays, transform
from priors.types import Camera, FloatMap, Mask, Matrix

ELEVATIONS_RAD = np.radians(np.concatenate([np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)]))
"""Elevations of the lines, the highest first."""
FIRING_RAD = np.radians(0.17)
"""Angle between two firings of one laser at 10 turns a second."""


def beam_of(xyz_m: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """Return the scan line (n,), 0 = the highest, of points (n, 3) in the scanner's axes."""
    middles = 0.5 * (ELEVATIONS_RAD[:-1] + ELEVATIONS_RAD[1:])
    return (63 - np.searchsorted(middles[::-1], _elevation(xyz_m))).astype(np.uint8)


def met(depth_m: FloatMap, camera: Camera, T_cam_lidar: Matrix, phase: float) -> Mask:
    """Tell which pixels of a dense map (h, w; 0 = none) a scanner elsewhere samples.

    A pixel is sampled where a scan line and a firing lie between it and the pixels below and beside it.

    Args:
        depth_m: the view's depth.
        camera: the view's camera.
        T_cam_lidar: where the scanner stands.
        phase: where its turn begins, in firings, 0 to 1.
    """
    xyz_m = transform(invert(T_cam_lidar), (rays(camera) * depth_m[..., None]).reshape(-1, 3))
    line = np.searchsorted(ELEVATIONS_RAD[::-1], _elevation(xyz_m)).reshape(depth_m.shape)
    azimuth = np.arctan2(xyz_m[:, 1], xyz_m[:, 0]).reshape(depth_m.shape)
    firing = np.floor(azimuth / FIRING_RAD + phase)
    hit = np.zeros(depth_m.shape, bool)
    hit[:-1, :-1] = (line[:-1, :-1] != line[1:, :-1]) & (firing[:-1, :-1] != firing[:-1, 1:])
    return hit & (depth_m > 0)


def _elevation(xyz_m: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    return np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1]))
