"""Measure how the LiDAR of a drive is turned against the camera, where it stands, and how late it is.

Surfaces that the pair and the sweep both see tell pitch, roll, height and delay; upright edges tell yaw and how far
aside it is. docs/extrinsics.md.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from priors.errors import DataError
from priors.extrinsics.belief import UNKNOWNS, Belief
from priors.extrinsics.correction import Correction
from priors.extrinsics.edges import EdgeView, told_by_edges
from priors.extrinsics.fit import fit_surfaces
from priors.extrinsics.measured import SURE, Measured
from priors.extrinsics.surfaces import SurfaceView
from priors.types import Drive, Frame

FRAMES = 12
"""Frames that are looked at, spread over the drive."""
FEWEST_FRAMES = 3
REACH_DEG, FAR_REACH_DEG, FAR_REACH_M = 0.3, 1.2, 0.4
"""How far edges look for yaw around what surfaces say; without a pair, and how far the car may go in a delay then."""
LARGEST_DEG = 2.0
"""More is no small correction: what is found there may be anything."""
UNTWISTED_DEG = 0.08
"""Error of yaw where the motion of the car is not known (standard deviation): a sweep that still holds it looks turned.
At 10 m/s a point 20 degrees aside is 5.5 cm off, a pixel of KITTI's at 15 m."""
SEEN: Mapping[str, float] = {"pitch": 0.2, "yaw": 0.2, "roll": 0.2, "delay": 0.01}
"""Standard errors, degrees and seconds, above which a number says nothing: it is not seen."""


def spread_frames(drive: Drive) -> list[int]:
    """Return the positions of the frames to look at: FRAMES of a drive, evenly, or all of a shorter one."""
    count = len(drive)
    return (
        sorted({round((n + 0.5) * count / FRAMES - 0.5) for n in range(FRAMES)})
        if count > FRAMES
        else list(range(count))
    )


def measure(frames: Sequence[Frame], on_frame: Callable[[], None] = lambda: None) -> Measured:
    """Measure turn and delay from several frames of one drive.

    Args:
        frames: with a sweep, an image and, for all but yaw, a pair; those that lack one, or cannot be read, are left
            out.
        on_frame: called after each.

    Raises:
        DataError: they show too little, or a turn that is no small correction.
    """
    edges, surfaces, ids = [], [], []
    for frame in frames:
        try:
            seen = look(frame)
        except DataError:
            seen = None  # it is told where the frame is used
        if seen is not None:
            edges.append(seen[0])
            surfaces += [] if seen[1] is None else [seen[1]]
            ids.append(frame.id)
        on_frame()
    if len(ids) < FEWEST_FRAMES:
        raise DataError(f"{len(ids)} frames have an image and a sweep: expected {FEWEST_FRAMES} or more")
    measured = _join(edges, surfaces if len(surfaces) >= FEWEST_FRAMES else [])
    if measured.correction.size_deg > LARGEST_DEG:
        found = f"{measured.correction.size_deg:.1f} degrees"
        raise DataError(f"it seems to be {found}, which is no small correction: calibrate LiDAR and camera again")
    return replace(measured, frames=ids)


def look(frame: Frame) -> tuple[EdgeView, SurfaceView | None] | None:
    """Look at a frame; None where it has no LiDAR, or misses its sweep."""
    if frame.T_cam_lidar is None or not (frame.has("sweep") and frame.has("image")):
        return None
    sweep = frame.sweep()
    if sweep is None:
        return None
    paired = frame.has("other") and bool(frame.baseline_m)
    surface = SurfaceView.of(frame, sweep) if paired else None
    return EdgeView.of(frame.image(), frame.camera, sweep, frame.T_cam_lidar), surface


def _join(edges: Sequence[EdgeView], surfaces: Sequence[SurfaceView]) -> Measured:
    """Measure by surfaces, then by edges too; DataError where neither tells anything."""
    fit = fit_surfaces(surfaces)
    belief = Belief.of_calibration() if fit is None else fit.belief
    reach = (REACH_DEG, 0.0) if fit is not None and fit.belief.errors[1] < SEEN["yaw"] else (FAR_REACH_DEG, FAR_REACH_M)
    told = told_by_edges(edges, belief.correction, *reach)
    if told is not None:
        belief = belief.after(told)
    elif fit is None:
        raise DataError(
            f"{len(edges)} frames show too few surfaces and outlines to tell how LiDAR and camera are turned"
        )
    moving = any(view.points.rate_m_s.any() for view in edges)
    return _measured(belief, fit is not None, moving)


def _measured(belief: Belief, paired: bool, moving: bool) -> Measured:
    """Return what is seen of a belief, where there was a pair, and where the car's motion is known."""
    if not moving:
        belief = belief.less_sure("yaw", UNTWISTED_DEG)
    seen = [belief.errors[n] < SEEN.get(name, np.inf) for n, name in enumerate(UNKNOWNS)]
    seen[UNKNOWNS.index("down")] &= paired
    pitch, yaw, roll, delay_s, right, down, forward = np.where(seen, belief.mean, 0.0).tolist()
    errors = np.where(seen, belief.errors, np.inf).tolist()
    if abs(delay_s) < SURE * errors[3]:
        delay_s = 0.0
    correction = Correction((pitch, yaw, roll), delay_s, (right, down, forward))
    return Measured(correction, (errors[0], errors[1], errors[2]), errors[3], (errors[4], errors[5], errors[6]))
