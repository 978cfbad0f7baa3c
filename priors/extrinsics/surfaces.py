"""Surfaces: what a stereo match and a sweep see of the same surface, and how a turn of the LiDAR would change it.

A road seen higher up is seen farther away: pitch and roll show on it, yaw on walls, a clock's delay in how near all is.
The pair's own rectification error looks alike in part. Its terms are unknowns beside the turn, as they are where the
stereo method measures them (priors/pairs/rectification.py).
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.egomotion.sight import WIDEST_PX, halve_camera
from priors.errors import DataError
from priors.extrinsics.correction import Correction
from priors.extrinsics.points import Points, crop, in_view
from priors.pairs.matching import halve, match
from priors.pairs.read import baseline, read_pair
from priors.pairs.rectification import RectificationError, usual_error
from priors.types import Camera, FloatMap, Frame, Image, Mask, Sweep

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

WINDOW_PX = 3
"""Of the matcher, in images that are halved."""
MOST = 4000
"""Points of a frame that are compared."""
REACH_PX = 4
"""A slope is that between pixels so far away on either side."""
BENT_PX = 0.6
"""Where the surface bends more between them, it is an edge."""
MATCHED = 6
"""Of 3 x 3 matches, those that make a mean."""
MISMATCH_PX = 4.0
RECTIFICATION, TURN, DELAY, PLACE = slice(0, 5), slice(5, 8), 8, slice(9, 12)
"""Columns: shift, tilt, yaw, pitch and stretch of the pair; turn, rad; delay, s; the LiDAR's place, m."""
COLUMNS = 12


class Slopes(NamedTuple):
    """How a disparity map changes from pixel to pixel."""

    across: FloatMap
    """(height, width) px a column."""
    down: FloatMap
    """(height, width) px a row."""
    smooth: Mask
    """(height, width) where both are those of one surface."""


@dataclass(frozen=True)
class SurfaceView:
    """What a frame's pair and sweep show of surfaces, in images of at most WIDEST_PX."""

    points: Points
    camera: Camera
    fx_baseline: float
    """Focal length times baseline, px m."""
    matched_px: FloatMap
    """(height, width) disparity; 0 = none."""
    slopes: Slopes
    usual: RectificationError
    """What the rig's pairs usually have, in pixels of the small image."""

    @classmethod
    def of(cls, frame: Frame, sweep: Sweep) -> "SurfaceView":
        """Match a frame's pair and take points of its sweep; DataError where the pair cannot be read."""
        if frame.T_cam_lidar is None:
            raise DataError(f"frame {frame.id}: where the LiDAR is, is not known")
        pair, camera, fx_baseline = read_pair(frame), frame.camera, frame.camera.fx * baseline(frame)
        matched_px, camera, scale = match_small(pair.left, pair.right, camera)
        points = Points.of_sweep(crop(sweep, frame.camera, frame.T_cam_lidar), frame.T_cam_lidar)
        seen = np.flatnonzero(in_view(camera, points.xyz_m + points.origin_m))
        some = seen[:: max(1, -(-len(seen) // MOST))]
        matched_px = pair.restore(matched_px)
        return cls(
            points.take(some),
            camera,
            fx_baseline / scale,
            matched_px,
            slopes(matched_px),
            usual_error(frame.rig, camera),
        )

    def compare(self, by: Correction, error: RectificationError, mismatch_px: float) -> tuple[Floats, Floats]:
        """Compare the sweep, corrected, with the match, corrected.

        Points on edges, without a match, or off by more than `mismatch_px` are left out.

        Returns:
            factors (n, COLUMNS), what each unknown adds to the match less the sweep; residuals (n,), the sweep's
            disparity less the match's, px.
        """
        around_m = self.points.placed(by)
        which = np.flatnonzero(in_view(self.camera, around_m))
        which = which[self.slopes.smooth[self._cells(around_m[which])]]
        xyz_m = around_m[which]
        u, v = self._pixels(xyz_m)
        row, column = cell = self._cells(xyz_m)
        across, down = (slope[cell].astype(np.float64) for slope in self.slopes[:2])
        matched_px = self.matched_px[cell] + across * (u - column) + down * (v - row)
        X, Y = (u - self.camera.K[0, 2]) / self.camera.fx, (v - self.camera.K[1, 2]) / self.camera.K[1, 1]
        pair = np.stack([np.ones_like(X), X, X * X, X * Y, matched_px], axis=1)
        corrected_px = matched_px + pair @ np.array([*error.offset_px, error.scale - 1])
        residual_px = self.fx_baseline / xyz_m[:, 2] - corrected_px
        near = np.abs(residual_px) < mismatch_px
        factors = np.concatenate([pair, self._moves(by, which, across, down)], axis=1)
        return factors[near], residual_px[near]

    def _pixels(self, xyz_m: Floats) -> tuple[Floats, Floats]:
        K = self.camera.K
        return K[0, 0] * xyz_m[:, 0] / xyz_m[:, 2] + K[0, 2], K[1, 1] * xyz_m[:, 1] / xyz_m[:, 2] + K[1, 2]

    def _cells(self, xyz_m: Floats) -> tuple[Indices, Indices]:
        """Return the rows and columns (n,) of the pixels that points (n, 3) in view fall into."""
        u, v = self._pixels(xyz_m)
        return np.rint(v).astype(np.int64), np.rint(u).astype(np.int64)

    def _moves(self, by: Correction, which: Indices, across: Floats, down: Floats) -> Floats:
        """Return what turn, delay and place (n, 7) add to the match less the sweep, by how they move each point."""
        some = self.points.take(which)
        xyz_m = some.placed(by)
        x, y, z = xyz_m.T
        fx, fy = self.camera.K[0, 0], self.camera.K[1, 1]
        by_x, by_y = across * fx / z, down * fy / z
        by_z = -(across * fx * x + down * fy * y) / z**2 + self.fx_baseline / z**2
        by_place = np.stack([by_x, by_y, by_z], axis=1)
        by_turn = np.cross(xyz_m - some.origin_m - np.array(by.moved_m), by_place)
        by_delay = np.sum(by_place * (some.rate_m_s @ by.R.T), axis=1)
        return np.concatenate([by_turn, by_delay[:, None], by_place], axis=1)


def match_small(left: Image, right: Image, camera: Camera) -> tuple[FloatMap, Camera, int]:
    """Match a pair, halved to at most WIDEST_PX; returns disparity (height, width), px, its camera, and the scale."""
    left, right, scale = as_grey(left), as_grey(right), 1
    while left.shape[1] > WIDEST_PX:
        left, right, camera, scale = halve(left), halve(right), halve_camera(camera), 2 * scale
    return match(left, right, window=WINDOW_PX), camera, scale


def slopes(matched_px: FloatMap) -> Slopes:
    """Return the slopes of a disparity map (height, width), px, 0 = none, between means of 3 x 3 matches."""
    there = (matched_px > 0).astype(np.float32)
    count = cv2.boxFilter(there, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(matched_px, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    mean = np.where(count >= MATCHED, total / np.maximum(count, 1), np.float32(0))
    wide = np.pad(mean, REACH_PX)
    height, width = mean.shape
    mid, last = slice(REACH_PX, -REACH_PX), 2 * REACH_PX
    left, right = wide[mid, :width], wide[mid, last:]
    above, below = wide[:height, mid], wide[last:, mid]
    smooth = (matched_px > 0) & (mean > 0) & (left > 0) & (right > 0) & (above > 0) & (below > 0)
    smooth &= (np.abs(left + right - 2 * mean) < BENT_PX) & (np.abs(above + below - 2 * mean) < BENT_PX)
    return Slopes((right - left) / last, (below - above) / last, smooth)
