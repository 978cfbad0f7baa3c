"""Calibration: is this a camera, and a pair, that a car would carry?"""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np

from priors.check.finding import Finding
from priors.types import Drive, Frame

BASELINE_M = (0.05, 3.0)
"""Of a car's pair, at least and at most."""


@runtime_checkable
class Remarking(Protocol):
    """A drive that says what its reader did to the images, or decided about the camera."""

    def notes(self) -> list[str]:
        """Return a line each."""
        ...


def judge_calibration(drive: Drive, frame: Frame) -> Iterator[Finding]:
    """Judge focal length, principal point and baseline of a frame, and repeat what the reader says."""
    yield from _judge_camera(frame)
    for note in drive.notes() if isinstance(drive, Remarking) else []:
        yield Finding("note", "calibration", note)


def _judge_camera(frame: Frame) -> Iterator[Finding]:
    (height, width), K = frame.camera.size, frame.camera.K
    angle = float(np.degrees(2 * np.arctan(0.5 * width / K[0, 0])))
    shown = f"{width}x{height}, focal length {K[0, 0]:.1f} px ({angle:.0f} degrees)"
    centred = 0.25 < K[0, 2] / width < 0.75 and 0.25 < K[1, 2] / height < 0.75
    if not centred:
        centre = f"centre ({K[0, 2]:.0f}, {K[1, 2]:.0f}) far from the middle"
        yield Finding("fatal", "calibration", f"{shown}, {centre}: were images or calibration resized or cropped?")
    elif not 15 < angle < 140 or not 0.8 < K[0, 0] / K[1, 1] < 1.25:
        yield Finding("warning", "calibration", f"{shown}, fy {K[1, 1]:.1f} px: unusual, is it this camera's?")
    else:
        yield Finding("ok", "calibration", shown)
    if frame.baseline_m is not None:
        usual = is_usual_baseline(frame)
        text = f"baseline {frame.baseline_m:.3f} m, this is the {frame.side} camera"
        yield Finding("ok" if usual else "warning", "calibration", text + ("" if usual else ": unusual, is it metres?"))


def is_usual_baseline(frame: Frame) -> bool:
    """Tell whether a car carries a pair of that baseline; True where there is none."""
    return frame.baseline_m is None or BASELINE_M[0] <= frame.baseline_m <= BASELINE_M[1]
