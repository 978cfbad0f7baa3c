"""Depth from LiDAR: sweeps accumulated by poses, z-buffered, and cleaned of what the camera does not see.

What must go, and the test that finds it:
- A far surface seen through the gaps between a near surface's scan lines (`hidden`).
- A thing that moved between the sweeps: where the frame's own sweep looks past the point (`looked_past`).
- Either of them, and what no LiDAR tells: where the stereo pair sees another depth (`stereo_denies`).

The windows are angles: what separates a 64-line scanner's samples, turned into pixels by the focal length.
"""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from priors.errors import DataError
from priors.geometry import invert
from priors.types import Depth, FloatMap, Frame, Mask, Matrix, Sweep

LINE_GAP_RAD = 0.0074  # between two scan lines of an HDL-64: 0.42 degrees
COLUMN_GAP_RAD = 0.0030  # between two firings of one laser at 10 Hz: 0.17 degrees
AGREE = 0.02  # share of the depth within which two sweeps see the same surface
NEARER = 0.05  # share of the depth by which another surface lies in front
STEREO_SLACK_PX, STEREO_SLACK = 1.0, 0.05  # px at full size plus a share of the disparity
STEREO_FOCAL_PX = 721.0  # the slack's pixels are those of KITTI's cameras
NO_SOURCE = np.int16(32767)


@dataclass(frozen=True)
class Lidar:
    """Project the LiDAR's sweep, or several accumulated by the drive's poses, and drop what the camera does not see.

    A drive (or frame) without poses has its own sweep only; sweeps that the drive misses are left out.
    """

    sweeps: int = 11
    """How many sweeps to accumulate, centred on the frame: 1 is its own only."""
    occlusion: bool = True
    """Drop points that lie behind a nearer surface."""
    motion: bool = True
    """Drop points of other sweeps that the frame's own sweep looks past: what moved."""
    stereo: bool = True
    """Drop points that the stereo pair contradicts, where the drive has a second camera."""

    def __post_init__(self) -> None:
        if self.sweeps < 1:
            raise DataError(f"lidar: sweeps is {self.sweeps}, expected 1 or more")

    def resolve(self, frame: Frame) -> Self:
        """Return the config as it will work on this drive: without poses or a second camera, parts are off."""
        sweeps = self.sweeps if frame.T_world_cam is not None else 1
        return replace(self, sweeps=sweeps, stereo=self.stereo and frame.baseline_m is not None)

    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis.

        Raises DataError where the drive has no LiDAR, or misses every sweep around the frame.
        """
        depth_m, sources = accumulate(frame, self.sweeps)
        seen = np.isfinite(depth_m)
        if self.motion and self.sweeps > 1:
            seen &= ~looked_past(depth_m, sources, frame.camera.fx)
        if self.occlusion:
            seen &= ~hidden(np.where(seen, depth_m, np.float32(np.inf)), frame.camera.fx)
        if self.stereo and frame.baseline_m is not None and frame.has("other"):
            seen &= ~stereo_denies(frame, depth_m, seen)
        return Depth(np.where(seen, depth_m, np.float32(0)))


def accumulate(frame: Frame, count: int) -> tuple[FloatMap, "np.ndarray[tuple[int, ...], np.dtype[np.int16]]"]:
    """Z-buffer `count` sweeps around the frame, its own first.

    Returns:
        depth_m (height, width), inf where no point falls, and the offset of the sweep each value is from.
    """
    from priors.kernels.zbuffer import splat

    depth_m = np.full(frame.camera.size, np.inf, dtype=np.float32)
    sources = np.full(frame.camera.size, NO_SOURCE)
    found = False
    for offset in sorted(range(-(count // 2), (count + 1) // 2), key=abs):
        placed = _place(frame, offset)
        if placed is None:
            continue
        sweep, T_cam_lidar = placed
        P = frame.camera.K @ T_cam_lidar[:3]
        if sweep.time_s is None or sweep.velocity is None:
            splat(sweep.xyz_m, np.zeros(0, np.float32), np.zeros(6), P, offset, AGREE, depth_m, sources)
        else:
            splat(sweep.xyz_m, sweep.time_s, sweep.velocity, P, offset, AGREE, depth_m, sources)
        found = True
    if not found:
        raise DataError(f"frame {frame.id}: no sweep at it or {count // 2} frames around: leave it out with --frames")
    return depth_m, sources


def _place(frame: Frame, offset: int) -> tuple[Sweep, Matrix] | None:
    """Read a sweep and say where it stood; None where it is missing, or its place is unknown."""
    try:
        sweep = frame.sweep(offset)
    except DataError:
        if offset == 0:
            raise
        return None  # a damaged neighbour is reported by its own frame; this one can do without
    if sweep is None:
        return None
    if offset == 0 and frame.T_cam_lidar is not None:
        return sweep, frame.T_cam_lidar
    if sweep.T_world_lidar is None or frame.T_world_cam is None:
        return None
    return sweep, invert(frame.T_world_cam) @ sweep.T_world_lidar


def hidden(depth_m: FloatMap, fx_px: float) -> Mask:
    """Tell which values (height, width; inf = none) lie inside the outline of a nearer surface.

    A value is inside when each of the four quadrants around it, a scan line's gap high, holds a nearer value. No plane
    hides itself, however grazing: on one side of every line in the image its depth does not fall.
    """
    rows, columns = 1 + round(LINE_GAP_RAD * fx_px), 1 + round(1.5 * COLUMN_GAP_RAD * fx_px)
    nearer = depth_m * np.float32(1 - NEARER)
    inside = np.isfinite(depth_m)
    for anchor_y in (0, rows):
        for anchor_x in (0, columns):
            inside &= _lowest(depth_m, rows + 1, columns + 1, anchor_x, anchor_y) < nearer
    return inside


def looked_past(depth_m: FloatMap, sources: "np.ndarray[tuple[int, ...], np.dtype[np.int16]]", fx_px: float) -> Mask:
    """Tell which values of other sweeps float where the own sweep (source 0) sees a farther surface.

    The own sweep must have samples both above and below, within a scan line's gap, all of them farther: the point's
    surface was not there when the own sweep, and the camera, looked.
    """
    rows, columns = 1 + round(LINE_GAP_RAD * fx_px), round(COLUMN_GAP_RAD * fx_px)
    own = np.where(sources == 0, depth_m, np.float32(np.inf))
    above = _lowest(own, rows + 1, 2 * columns + 1, columns, rows)
    below = _lowest(own, rows + 1, 2 * columns + 1, columns, 0)
    past = (sources != 0) & np.isfinite(above) & np.isfinite(below)
    return past & (np.minimum(above, below) > depth_m * np.float32(1 + NEARER))


def _lowest(depth_m: FloatMap, rows: int, columns: int, anchor_x: int, anchor_y: int) -> FloatMap:
    """Return the smallest value in a window around every pixel; the anchor is the pixel's place in it."""
    return np.asarray(cv2.erode(depth_m, np.ones((rows, columns), np.uint8), anchor=(anchor_x, anchor_y)))


def stereo_denies(frame: Frame, depth_m: FloatMap, seen: Mask) -> Mask:
    """Tell which values disagree with a quick stereo match, where that has one, or has one beside."""
    from priors.matching import quick_match

    if not seen.any() or frame.baseline_m is None:
        return np.zeros_like(seen)
    focal_baseline = np.float32(frame.camera.fx * frame.baseline_m)
    disparity_px = focal_baseline / depth_m
    largest = int(np.ceil(np.quantile(disparity_px[seen], 0.999))) + 4
    image, other = frame.image(), frame.other()
    if frame.side == "left":
        matched_px = quick_match(image, other, largest)
    else:  # in the mirror, the right camera is the left one
        matched_px = quick_match(image[:, ::-1], other[:, ::-1], largest)[:, ::-1]
    window = np.ones((3, 3), np.uint8)
    known = matched_px > 0
    lowest = cv2.erode(np.where(known, matched_px, np.float32(np.inf)), window)
    highest = cv2.dilate(matched_px, window)
    slack_px = np.float32(STEREO_SLACK_PX * frame.camera.fx / STEREO_FOCAL_PX) + np.float32(STEREO_SLACK) * disparity_px
    outside = (disparity_px < lowest - slack_px) | (disparity_px > highest + slack_px)
    return np.asarray(known & outside)
