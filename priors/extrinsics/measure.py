"""Measure how the LiDAR of a drive is turned against the camera, and how late it is, from several frames.

Surfaces that the pair and the sweep both see tell pitch, roll and delay; upright edges tell yaw. docs/extrinsics.md.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from priors.errors import DataError
from priors.extrinsics.correction import NONE, Correction
from priors.extrinsics.edges import EdgeView, Yaw, yaw_by_edges
from priors.extrinsics.fit import UNKNOWNS, Fit, fit_surfaces
from priors.extrinsics.surfaces import SurfaceView
from priors.types import Camera, Drive, Frame

FRAMES = 12
"""Frames that are looked at, spread over the drive."""
FEWEST_FRAMES = 3
REACH_DEG, FAR_REACH_DEG = 0.3, 1.2
"""How far edges look for yaw around what surfaces say; without a pair."""
LARGEST_DEG = 2.0
"""More is no small correction: what is found there may be anything."""
SURFACES_PX, EDGES_PX, PLACE_DEG = 0.25, 0.25, 0.04
"""Errors of yaw that more frames do not lower (standard deviation): of either way alone, in its images; of both, by a
LiDAR whose place is known within 1 cm."""
SURE_TURN = 2.0
"""An angle is corrected from so many standard errors on: below, a calibration is rather right than the measurement."""
SURE = 3.0
"""A delay counts from so many standard errors on."""
SEEN: Mapping[str, float] = {"pitch": 0.2, "yaw": 0.2, "roll": 0.2, "delay": 0.01}
"""Standard errors, degrees and seconds, above which a number says nothing: it is not seen."""
Angles: TypeAlias = tuple[float, float, float]
AXES = ("pitch", "yaw", "roll")


@dataclass(frozen=True)
class Measured:
    """What was measured. What cannot be seen is 0 in the correction, and its error is inf."""

    correction: Correction
    errors_deg: Angles
    """Standard errors of pitch, yaw and roll, degrees."""
    delay_error_s: float
    """Standard error of the delay, seconds."""
    frames: Sequence[str] = field(default_factory=list)
    """Ids of the frames that were looked at."""

    @property
    def error_deg(self) -> float:
        """Standard error of the turn's size, degrees; inf where its direction is not seen at all."""
        seen = np.isfinite(self.errors_deg)
        turn, errors = np.array(self.correction.turn_deg)[seen], np.array(self.errors_deg)[seen]
        size = float(np.linalg.norm(turn))
        return float(np.linalg.norm(turn * errors)) / size if size > 0 else float(np.max(errors, initial=0))

    @property
    def sure(self) -> Correction:
        """The part of the correction that is worth applying: angles of at least SURE_TURN standard errors."""
        turn, errors = np.array(self.correction.turn_deg), np.array(self.errors_deg)
        pitch, yaw, roll = (float(each) for each in np.where(np.abs(turn) >= SURE_TURN * errors, turn, 0.0))
        return replace(self.correction, turn_deg=(pitch, yaw, roll))

    @property
    def has_delay(self) -> bool:
        """Whether a delay was found."""
        return self.correction.delay_s != 0

    def __str__(self) -> str:
        """Tell the numbers."""
        shown = [
            f"{axis} {value:+.2f} +-{error:.2f}" if np.isfinite(error) else f"{axis} not seen"
            for axis, value, error in zip(AXES, self.correction.turn_deg, self.errors_deg, strict=True)
        ]
        text = f"turned by {self.correction.size_deg:.2f} degrees ({', '.join(shown)})"
        if not np.isfinite(self.delay_error_s):
            return f"{text}; delay not seen"
        error_ms = 1000 * self.delay_error_s
        if not self.has_delay:
            return f"{text}; no delay (+-{error_ms:.0f} ms)"
        return f"{text}; {1000 * self.correction.delay_s:+.0f} +-{error_ms:.0f} ms late"

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it; an error that is inf is null."""
        errors = [error if np.isfinite(error) else None for error in (*self.errors_deg, self.delay_error_s)]
        turn, delay_s = list(self.correction.turn_deg), self.correction.delay_s
        return {"turn_deg": turn, "delay_s": delay_s, "errors": errors, "frames": list(self.frames)}

    @classmethod
    def restore(cls, record: dict[str, Any]) -> "Measured":
        """Read such a record; KeyError, TypeError or ValueError where it is none."""
        pitch, yaw, roll = (float(angle) for angle in record["turn_deg"])
        *turn, delay = (np.inf if error is None else float(error) for error in record["errors"])
        errors: Angles = (turn[0], turn[1], turn[2])
        return cls(Correction((pitch, yaw, roll), float(record["delay_s"])), errors, delay, list(record["frames"]))


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
            seen = _look(frame)
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


def _look(frame: Frame) -> tuple[EdgeView, SurfaceView | None] | None:
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
    """Measure by surfaces, then yaw by edges too, then the rest beside that yaw."""
    moving = any(view.points.rate_m_s.any() for view in surfaces)
    free = [*AXES, "delay"] if moving else list(AXES)
    fit = fit_surfaces(surfaces, NONE, free)
    if fit is None:
        return _by_edges_alone(edges)
    delay_error_s = float(fit.errors[3])
    if abs(fit.correction.delay_s) < SURE * delay_error_s:  # what is wrong with a delay would go into yaw
        free = list(AXES)
        fit = fit_surfaces(surfaces, NONE, free) or fit
    free = [name for name, error in zip(UNKNOWNS, fit.errors, strict=True) if name in free and error < SEEN[name]]
    fit = fit_surfaces(surfaces, NONE, free) if free else None
    if fit is None:
        return _by_edges_alone(edges)
    by_edges = yaw_by_edges(edges, fit.correction, REACH_DEG)
    yaw_deg, yaw_error = _yaw(fit, by_edges, surfaces[0].camera, edges[0].camera)
    delay_error_s = delay_error_s if delay_error_s < SEEN["delay"] else np.inf
    return _beside(yaw_deg, yaw_error, surfaces, fit, free, delay_error_s)


def _yaw(fit: Fit, by_edges: Yaw | None, small: Camera, whole: Camera) -> tuple[float, float]:
    """Return the weighted mean of what surfaces and edges say of yaw, and its error, degrees; 0 and inf of neither."""
    yaws, variances = np.array([fit.correction.turn_deg[1], 0.0]), np.array([np.inf, np.inf])
    variances[0] = _angle(SURFACES_PX, small) ** 2 + max(0.0, float(fit.errors[1]) ** 2 - PLACE_DEG**2)
    if by_edges is not None:
        yaws[1], variances[1] = by_edges.deg, _angle(EDGES_PX, whole) ** 2 + by_edges.error_deg**2
    weights = 1 / variances
    if not weights.any():
        return 0.0, np.inf
    return float(weights @ yaws / weights.sum()), float(np.hypot(PLACE_DEG, weights.sum() ** -0.5))


def _angle(px: float, camera: Camera) -> float:
    """Return the angle of so many pixels in the middle of an image, degrees."""
    return float(np.degrees(px / camera.fx))


def _beside(
    yaw_deg: float, yaw_error: float, surfaces: Sequence[SurfaceView], fit: Fit, free: list[str], delay_error_s: float
) -> Measured:
    """Fit the rest beside a yaw."""
    pitch, _, roll = fit.correction.turn_deg
    start = replace(fit.correction, turn_deg=(pitch, yaw_deg, roll))
    rest = fit_surfaces(surfaces, start, [name for name in free if name != "yaw"]) or fit
    errors = float(rest.errors[0]), yaw_error, float(rest.errors[2])
    return Measured(rest.correction, errors, delay_error_s)


def _by_edges_alone(edges: Sequence[EdgeView]) -> Measured:
    """Measure yaw without a pair; DataError where edges do not tell it."""
    yaw = yaw_by_edges(edges, NONE, FAR_REACH_DEG)
    if yaw is None:
        raise DataError(
            f"{len(edges)} frames show too few surfaces and outlines to tell how LiDAR and camera are turned"
        )
    error = float(np.hypot(PLACE_DEG, np.hypot(_angle(EDGES_PX, edges[0].camera), yaw.error_deg)))
    return Measured(Correction((0.0, yaw.deg, 0.0)), (np.inf, error, np.inf), np.inf)
