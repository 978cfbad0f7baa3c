"""Depth from LiDAR: sweeps accumulated by poses, z-buffered, and cleaned of what the camera does not see.

What must go, and the test that finds it:
- A far surface seen through the gaps between a near surface's scan lines (`hidden`).
- A thing that moved between the sweeps: where the frame's own sweep looks past the point (`free_space`).
- Either of them, and what no LiDAR tells: where the stereo pair sees another depth (`stereo_denies`).

The windows are angles: what separates a 64-line scanner's samples, turned into pixels by the focal length.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import cv2
import numpy as np

from priors.errors import DataError, expect_between, expect_choices
from priors.extrinsics.correction import Correction
from priors.geometry import invert
from priors.machine import threads
from priors.pairs.matching import quick_match
from priors.pairs.read import read_pair
from priors.types import Depth, Drive, FloatMap, Frame, Input, Mask, Matrix, Method, Sweep

LINE_GAP_RAD = 0.0074  # between two scan lines of an HDL-64: 0.42 degrees
COLUMN_GAP_RAD = 0.0030  # between two firings of one laser at 10 Hz: 0.17 degrees
AGREE = 0.02  # share of the depth within which two sweeps see the same surface
HIDING = ((0.011, 0.008, 0.05), (0.033, 0.022, 0.2))  # rows and columns (rad), and the share by which it is nearer
FREE = 0.05  # share of the depth that free space ends before the surface behind it
SUPPORT_RAD = 0.0055  # how far around a value others speak for it
STEADY = 0.1  # spread of the inverse depth, as a share of its mean, at which a full neighbourhood speaks half for it
STEREO_SLACK_PX, STEREO_SLACK = 1.0, 0.05  # px at full size plus a share of the disparity
STEREO_FOCAL_PX = 721.0  # the slack's pixels are those of KITTI's cameras
SEARCH_MARGIN_PX = 4  # beyond the disparities that the LiDAR saw
NO_SOURCE = np.int16(32767)
MOST_SWEEPS = 10_001  # 17 minutes at 10 Hz
FEW = 10  # frames in which poses are looked for


@dataclass(frozen=True)
class Lidar(Method):
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
    extrinsics: Literal["calibration", "measured"] = "calibration"
    """How the LiDAR is turned against the camera, and how late it is: as calibrated, or as a dozen frames of the drive
    show it, measured once (`priors check` tells what they show)."""

    VERSION: ClassVar[int] = 1
    BEFORE: ClassVar[Mapping[str, Any]] = {"extrinsics": "calibration"}

    def __post_init__(self) -> None:
        expect_choices(self, "lidar.")
        expect_between(1, self.sweeps, MOST_SWEEPS, "--lidar.sweeps")

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("sweep",)

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config as it will work on this drive: without poses or a second camera, parts are off."""
        # A pose that is missing by mistake is told for each frame, not left out of the config.
        known = frame.T_world_cam is not None or "pose" in frame.missing
        sweeps = self.sweeps if known else 1
        return replace(self, sweeps=sweeps, stereo=self.stereo and frame.baseline_m is not None)

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        """Tell that a drive has no poses, and measure its extrinsics where that is asked for."""
        if self.sweeps == 1 and not any(drive[index].T_world_cam is not None for index in range(min(len(drive), FEW))):
            on_note(f"{drive.name}: no poses to accumulate sweeps by: each map is made of its own sweep alone")
        if self.extrinsics == "calibration":
            return self
        correction, plain = self.correction(drive, folder, on_note), self.as_calibrated()
        return lambda frame: plain(correction.frame(frame))

    def correction(self, drive: Drive, folder: Path, on_note: Callable[[str], None]) -> Correction:
        """Return what corrects a drive's frames, as `extrinsics` has it; DataError where they show too little."""
        from priors.extrinsics.kept import measured_on  # scipy: not for --help

        return measured_on(drive, folder, on_note).sure

    def as_calibrated(self) -> Self:
        """Return the same for frames that are corrected already."""
        return replace(self, extrinsics="calibration")

    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis.

        Raises DataError where the drive has no LiDAR, or misses every sweep around the frame.
        """
        return self.look(frame)

    @threads.limited(None)
    def look(self, frame: Frame, hiding: float = 1.0) -> Depth:
        """Make the map with windows that look for nearer surfaces `hiding` times as large as usual: see `hidden`.

        Raises DataError where the extrinsics are to be measured: that needs the drive (see prepare).
        """
        if self.extrinsics == "measured":
            raise DataError("lidar: measured extrinsics need the drive: call prepare first")
        depth_m = accumulate(frame, self.sweeps, self.motion)
        if self.occlusion:
            depth_m[hidden(depth_m, frame.camera.fx, hiding)] = np.inf
        if self.stereo and frame.baseline_m is not None and frame.has("other"):
            depth_m[stereo_denies(frame, depth_m)] = np.inf
        trust = confidence(depth_m, frame.camera.fx)
        depth_m[np.isinf(depth_m)] = 0
        return Depth(depth_m, trust)


def accumulate(frame: Frame, count: int, motion: bool = True) -> FloatMap:
    """Z-buffer `count` sweeps around the frame, its own first: depth (height, width), inf where no point falls.

    With `motion`, points of the others are left out where the own sweep sees free space.
    """
    from priors.kernels.zbuffer import splat

    if count > 1 and frame.T_world_cam is None and "pose" in frame.missing:
        raise DataError(f"frame {frame.id}: {frame.missing['pose']}; or take its own sweep alone: --lidar.sweeps 1")
    depth_m = np.full(frame.camera.size, np.inf, dtype=np.float32)
    sources = np.full(frame.camera.size, NO_SOURCE)
    free_m = np.zeros((0, 0), dtype=np.float32)  # not known
    used = 0
    for offset in sorted(range(-(count // 2), (count + 1) // 2), key=abs):
        placed = _place(frame, offset)
        if placed is None:
            continue
        sweep, T_cam_lidar = placed
        P = frame.camera.K @ T_cam_lidar[:3]
        if sweep.time_s is None or sweep.velocity is None:
            splat(sweep.xyz_m, np.zeros(0, np.float32), np.zeros(6), P, offset, AGREE, free_m, depth_m, sources)
        else:
            splat(sweep.xyz_m, sweep.time_s, sweep.velocity, P, offset, AGREE, free_m, depth_m, sources)
        if offset == 0 and motion and count > 1:
            free_m = free_space(depth_m, frame.camera.fx)
        used += 1
    if not used:
        raise DataError(f"frame {frame.id}: no sweep at it or {count // 2} frames around: leave it out with --frames")
    return depth_m


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


def hidden(depth_m: FloatMap, fx_px: float, windows: float = 1.0) -> Mask:
    """Tell which values (height, width; inf = none) lie inside a nearer surface's outline.

    A value is inside when each of the four quadrants around it holds a nearer value. No plane hides itself, however
    grazing: on one side of every line in the image its depth does not fall. The windows are larger than a scan line's
    gap because glass and glossy paint return nothing; the larger one asks for a surface that is clearly another.
    Windows that are `windows` times as large drop fewer true values beside outlines, and miss more that are hidden.
    """
    from priors.kernels.visibility import hide

    inside = np.zeros(depth_m.shape, dtype=bool)
    for rows_rad, columns_rad, share in HIDING:
        nearest_m = _nearest(depth_m, round(windows * rows_rad * fx_px), round(windows * columns_rad * fx_px))
        hide(depth_m, nearest_m, share, inside)
    return inside


def free_space(own_m: FloatMap, fx_px: float) -> FloatMap:
    """Return how far space is free for certain along every pixel, metres, by one sweep (inf = none); 0 = not known.

    It is where samples lie both above and below, within a scan line's gap: a little less far than the nearest of them.
    A point nearer than that was not there when this sweep, and the camera, looked.
    """
    from priors.kernels.visibility import free_until

    height, width = own_m.shape
    rows, columns = window(fx_px)
    nearest_m = _nearest(own_m, rows, 2 * columns)[:, columns : columns + width]
    return free_until(nearest_m, height, FREE)


def window(fx_px: float) -> tuple[int, int]:
    """Return how many rows and columns away the scanner's next sample is: one more than the gap."""
    return 1 + round(LINE_GAP_RAD * fx_px), 1 + round(COLUMN_GAP_RAD * fx_px)


def _nearest(depth_m: FloatMap, rows: int, columns: int) -> FloatMap:
    """Return the smallest value of every window (rows + 1, columns + 1) that touches the map.

    Element [i, j] of (height + rows, width + columns) is the window that ends at row i and column j.
    """
    padded = cv2.copyMakeBorder(depth_m, rows, rows, columns, columns, cv2.BORDER_CONSTANT, value=np.inf)
    smallest = cv2.erode(padded, np.ones((rows + 1, columns + 1), np.uint8), anchor=(0, 0))
    return np.asarray(smallest[: depth_m.shape[0] + rows, : depth_m.shape[1] + columns])


def stereo_denies(frame: Frame, depth_m: FloatMap) -> Mask:
    """Tell which values (inf = none) disagree with a quick stereo match, where that has one.

    A value may agree with any of the 3x3 disparities around it: at an outline the match is not sharper than that.
    """
    from priors.kernels.visibility import deny

    if frame.baseline_m is None:
        return np.zeros(depth_m.shape, dtype=bool)
    pair = read_pair(frame)
    focal_baseline = frame.camera.fx * frame.baseline_m
    largest_px = None  # the match finds it
    some_m = depth_m[::3, ::3]
    some_m = some_m[some_m < np.inf]
    if some_m.size > 0:
        largest_px = int(min(focal_baseline / np.quantile(some_m, 0.001), pair.left.shape[1] / 2)) + SEARCH_MARGIN_PX
    matched_px = pair.match(lambda left, right: quick_match(left, right, largest_px))
    slack_px = STEREO_SLACK_PX * frame.camera.fx / STEREO_FOCAL_PX
    return deny(depth_m, matched_px, focal_baseline, slack_px, STEREO_SLACK)


def confidence(depth_m: FloatMap, fx_px: float) -> FloatMap:
    """Return how well the values around speak for each (height, width; inf = none), in [0, 1].

    It is the share of the neighbourhood that has values, over 1 + (spread / STEADY)^2 with the spread of their inverse
    depth (standard deviation over mean): high inside a surface that many samples hit, low at outlines and for strays.
    """
    from priors.kernels.neighbour_support import support

    return support(depth_m, round(SUPPORT_RAD * fx_px), STEADY)
