"""Encoding: the unit and the kind of the numbers in an imported depth map."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal

import numpy as np

from priors.errors import DataError, UsageError, expect_choices
from priors.geometry import convert_disparity, depth_from_range
from priors.types import FloatMap, Frame

Kind = Literal["depth", "range", "disparity", "inverse"]
UNITS: Mapping[str, Fraction] = {
    "m": Fraction(1),
    "px": Fraction(1),
    "cm": Fraction(1, 100),
    "mm": Fraction(1, 1000),
    "1/256": Fraction(1, 256),
    "1/5000": Fraction(1, 5000),
}
"""What one is, in metres or pixels: KITTI's PNG are 1/256, nerfstudio's mm, TUM's 1/5000."""


@dataclass(frozen=True)
class Encoding:
    """How to read the numbers of imported maps."""

    VERSION: ClassVar[int] = 1  # raised when imported maps change

    unit: str | None = None
    """What one is: m, cm, mm, 1/256 or another fraction of a metre; of a pixel for --kind disparity, of 1/m for
    inverse. Default: 1 for .npy, .npz and .pfm; of a PNG it must be said."""
    kind: Kind = "depth"
    """depth: along the camera's z axis. range: along the ray. disparity: of the pair, pixels. inverse: 1 / depth."""

    def __post_init__(self) -> None:
        expect_choices(self, "")
        if self.unit is None:
            return
        fraction, is_length = self.fraction, self.kind in ("depth", "range")
        wrong = ("px",) if is_length else ("cm", "mm")
        if self.unit in wrong or not fraction > 0:
            wanted = "m, cm, mm or a fraction of a metre" if is_length else "a fraction, 1/256 say, or 1"
            raise UsageError(f"--unit {self.unit}: expected {wanted} for --kind {self.kind}")

    @property
    def fraction(self) -> Fraction:
        """Return what one is; 1 where nobody said."""
        if self.unit is None:
            return Fraction(1)
        try:
            return UNITS.get(self.unit) or Fraction(self.unit.replace(" ", ""))
        except (ValueError, ZeroDivisionError) as error:
            raise UsageError(f"--unit {self.unit}: expected m, cm, mm or a fraction of a metre, 1/256 say") from error

    def plain(self) -> "Encoding":
        """Return the same with the unit as a fraction: mm and 1/1000 are one encoding."""
        return Encoding(str(self.fraction), self.kind)

    def depth_m(self, numbers: FloatMap, frame: Frame) -> FloatMap:
        """Turn numbers (height, width), 0 = no value, into camera-z depth, metres.

        Raises:
            DataError: disparities of a frame without a pair.
        """
        values = (numbers.astype(np.float64) * float(self.fraction)).astype(np.float32)
        if self.kind == "depth":
            return values
        if self.kind == "range":
            return depth_from_range(frame.camera, values)
        if self.kind == "inverse":
            return convert_disparity(values, 1.0, 1.0)
        if frame.baseline_m is None:
            why = frame.missing.get("other", "it has no pair")
            raise DataError(f"frame {frame.id}: disparity needs the pair's baseline: {why}")
        return convert_disparity(values, frame.camera.fx, frame.baseline_m)
