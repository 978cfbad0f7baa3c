"""Measured: what a drive shows of its extrinsics, with standard errors, and the part of it that is worth applying."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from priors.extrinsics.correction import NONE, Correction

AXES = ("pitch", "yaw", "roll")
SIDES = ("right", "down", "forward")
SURE = 3.0
"""A turn, an angle or a delay counts from so many standard errors on: by chance one in 400 does. Below, a calibration
is rather right than the measurement."""
TURNED_DEG, LATE_S = 0.1, 0.005
"""A turn and a delay that count, and are larger by one standard error, are told and corrected: 1.3 px at KITTI's focal
length, and 7 cm at 50 km/h."""
Three: TypeAlias = tuple[float, float, float]
UNSEEN: Three = (np.inf, np.inf, np.inf)


@dataclass(frozen=True)
class Measured:
    """What was measured. What cannot be seen is 0 in the correction, and its error is inf."""

    correction: Correction
    errors_deg: Three
    """Standard errors of pitch, yaw and roll, degrees."""
    delay_error_s: float
    """Standard error of the delay, seconds."""
    moved_errors_m: Three = UNSEEN
    """Standard errors of the LiDAR's place, right, down and forward, metres."""
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
    def is_off(self) -> bool:
        """Whether the calibration is surely off, and likely by more than TURNED_DEG or LATE_S."""
        return is_sure(self.correction.size_deg, self.error_deg, TURNED_DEG) or is_sure(
            self.correction.delay_s, self.delay_error_s, LATE_S
        )

    @property
    def sure(self) -> Correction:
        """The part of the correction that is worth applying: nothing, or angles of at least SURE standard errors.

        Nothing where the calibration is not surely off: a pair's match has errors of its own, alike in all frames of a
        rig, which look like less than a tenth of a degree. The place goes with the angles, which were found beside it.
        """
        if not self.is_off:
            return NONE
        turn, errors = np.array(self.correction.turn_deg), np.array(self.errors_deg)
        pitch, yaw, roll = (float(each) for each in np.where(np.abs(turn) >= SURE * errors, turn, 0.0))
        if not (pitch or yaw or roll or self.has_delay):
            return NONE
        return replace(self.correction, turn_deg=(pitch, yaw, roll))

    @property
    def has_delay(self) -> bool:
        """Whether a delay was found."""
        return self.correction.delay_s != 0

    def __str__(self) -> str:
        """Tell the numbers."""
        turn = "; ".join([f"turned by {self.correction.size_deg:.2f} degrees ({self._angles()})", self._delay()])
        return turn if not np.isfinite(self.moved_errors_m).any() else f"{turn}; {self._place()}"

    def _angles(self) -> str:
        return ", ".join(
            f"{axis} {value:+.2f} +-{error:.2f}" if np.isfinite(error) else f"{axis} not seen"
            for axis, value, error in zip(AXES, self.correction.turn_deg, self.errors_deg, strict=True)
        )

    def _delay(self) -> str:
        if not np.isfinite(self.delay_error_s):
            return "delay not seen"
        error_ms = 1000 * self.delay_error_s
        if not self.has_delay:
            return f"no delay (+-{error_ms:.0f} ms)"
        return f"{1000 * self.correction.delay_s:+.0f} +-{error_ms:.0f} ms late"

    def _place(self) -> str:
        seen = zip(SIDES, self.correction.moved_m, self.moved_errors_m, strict=True)
        told = (
            f"{100 * value:+.1f} +-{100 * error:.1f} cm {side}" for side, value, error in seen if np.isfinite(error)
        )
        return f"it stands {', '.join(told)}"

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it; an error that is inf is null."""
        return {
            "turn_deg": list(self.correction.turn_deg),
            "delay_s": self.correction.delay_s,
            "moved_m": list(self.correction.moved_m),
            "errors": _or_null((*self.errors_deg, self.delay_error_s)),
            "moved_errors": _or_null(self.moved_errors_m),
            "frames": list(self.frames),
        }

    @classmethod
    def restore(cls, record: Mapping[str, Any]) -> "Measured":
        """Read such a record; KeyError, TypeError or ValueError where it is none."""
        pitch, yaw, roll = (float(angle) for angle in record["turn_deg"])
        right, down, forward = (float(metres) for metres in record["moved_m"])
        correction = Correction((pitch, yaw, roll), float(record["delay_s"]), (right, down, forward))
        a, b, c, delay = _or_inf(record["errors"])
        x, y, z = _or_inf(record["moved_errors"])
        return cls(correction, (a, b, c), delay, (x, y, z), list(record["frames"]))


def is_sure(value: float, error: float, limit: float) -> bool:
    """Tell whether a value is surely not 0, and likely beyond a limit, by its standard error."""
    return abs(value) >= SURE * error and abs(value) - error > limit


def _or_null(errors: Sequence[float]) -> list[float | None]:
    return [error if np.isfinite(error) else None for error in errors]


def _or_inf(errors: Sequence[float | None]) -> list[float]:
    return [np.inf if error is None else float(error) for error in errors]
