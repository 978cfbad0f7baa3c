"""Measure how the LiDAR of a drive is turned against the camera, where it stands, and how late it is.

Surfaces that the pair and the sweep both see tell pitch, roll, height and delay; upright edges tell yaw and how far
aside it is. docs/extrinsics.md.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from priors.errors import DataError
from priors.extrinsics.correction import NONE, Correction
from priors.extrinsics.edges import EdgeView, Yaw, yaw_by_edges
from priors.extrinsics.fit import PLACE_M, UNKNOWNS, Held, fit_surfaces
from priors.extrinsics.measured import AXES, SURE, Measured
from priors.extrinsics.surfaces import SurfaceView
from priors.types import Camera, Drive, Frame

FRAMES = 12
"""Frames that are looked at, spread over the drive."""
FEWEST_FRAMES = 3
REACH_DEG, FAR_REACH_DEG = 0.3, 1.2
"""How far edges look for yaw around what surfaces say; without a pair."""
LARGEST_DEG = 2.0
"""More is no small correction: what is found there may be anything."""
SURFACES_PX, EDGES_PX = 0.25, 0.25
"""Errors of yaw that more frames do not lower (standard deviation), of either way, in its images."""
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
    """Measure by surfaces, then yaw and how far aside by edges too, then the rest beside them."""
    moving = any(view.points.rate_m_s.any() for view in surfaces)
    free = [*AXES, "delay"] if moving else list(AXES)
    fit = fit_surfaces(surfaces, NONE, free)
    if fit is None:
        return _by_edges_alone(edges)
    delay_error_s = float(fit.errors[3])
    if abs(fit.correction.delay_s) < SURE * delay_error_s:  # what is wrong with a delay would go into yaw
        free = list(AXES)
        fit = fit_surfaces(surfaces, replace(fit.correction, delay_s=0.0), free) or fit
    free = [name for name, error in zip(UNKNOWNS, fit.errors, strict=False) if name in free and error < SEEN[name]]
    if not free:
        return _by_edges_alone(edges)
    aside = _aside(edges, surfaces, fit.correction, free)
    pitch, _, roll = (angle if axis in free else 0.0 for axis, angle in zip(AXES, fit.correction.turn_deg, strict=True))
    _, down, ahead = fit.correction.moved_m
    start = replace(fit.correction, turn_deg=(pitch, aside.deg, roll), moved_m=(aside.aside_m, down, ahead))
    yaw_error, aside_error_m = (float(error) for error in np.sqrt(np.diag(aside.covariance)))
    unknown_delay_s = min(delay_error_s, SEEN["delay"]) if moving else 0.0
    held = Held(min(yaw_error, SEEN["yaw"]), unknown_delay_s, aside_error_m)
    rest = fit_surfaces(surfaces, start, [name for name in free if name != "yaw"], held)
    if rest is None:
        return _by_edges_alone(edges)
    return Measured(
        rest.correction,
        (float(rest.errors[0]), yaw_error, float(rest.errors[2])),
        delay_error_s if delay_error_s < SEEN["delay"] else np.inf,
        (held.aside_m, float(rest.errors[5]), float(rest.errors[6])),
    )


def _aside(edges: Sequence[EdgeView], surfaces: Sequence[SurfaceView], start: Correction, free: Sequence[str]) -> Yaw:
    """Join what edges and surfaces say of yaw and of how far aside the LiDAR is, by generalised least squares."""
    found = yaw_by_edges(edges, start, REACH_DEG)
    value, information = np.array([0.0, 0.0]), np.diag([0.0, PLACE_M**-2])
    if found is not None:
        value = np.array([found.deg, found.aside_m])
        floor = np.diag([_angle(EDGES_PX, edges[0].camera) ** 2, 0.0])
        information = np.linalg.inv(found.covariance + floor)
    if "yaw" in free:
        right = replace(start, moved_m=(float(value[1]), *start.moved_m[1:]))
        fit = fit_surfaces(surfaces, right, free, Held(aside_m=0.0))
        if fit is not None:
            row = np.array([1.0, -fit.yaw_by_aside])
            weight = 1 / (float(fit.errors[1]) ** 2 + _angle(SURFACES_PX, surfaces[0].camera) ** 2)
            told = fit.correction.turn_deg[1] - fit.yaw_by_aside * value[1]
            joint = information + weight * np.outer(row, row)
            value = np.linalg.solve(joint, information @ value + weight * told * row)
            information = joint
    if information[0, 0] == 0:
        return Yaw(0.0, 0.0, np.diag([np.inf, PLACE_M**2]))
    return Yaw(float(value[0]), float(value[1]), np.linalg.inv(information))


def _angle(px: float, camera: Camera) -> float:
    """Return the angle of so many pixels in the middle of an image, degrees."""
    return float(np.degrees(px / camera.fx))


def _by_edges_alone(edges: Sequence[EdgeView]) -> Measured:
    """Measure yaw without a pair; DataError where edges do not tell it."""
    yaw = yaw_by_edges(edges, NONE, FAR_REACH_DEG)
    if yaw is None:
        raise DataError(
            f"{len(edges)} frames show too few surfaces and outlines to tell how LiDAR and camera are turned"
        )
    error = float(np.hypot(_angle(EDGES_PX, edges[0].camera), yaw.covariance[0, 0] ** 0.5))
    aside_error_m = float(yaw.covariance[1, 1] ** 0.5)
    correction = Correction((0.0, yaw.deg, 0.0), moved_m=(yaw.aside_m, 0.0, 0.0))
    return Measured(correction, (np.inf, error, np.inf), np.inf, (aside_error_m, np.inf, np.inf))
