"""Imported maps: is their unit and kind what was said? They are compared with LiDAR, truth and stereo."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from priors.check.audit import yield_into
from priors.check.finding import Finding
from priors.check.maps import BAD, OFF, Comparison, compare
from priors.check.sample import Sample
from priors.check.scale import NEAR, three_digits
from priors.check.stereo import judge_stereo
from priors.types import FloatMap, Frame

NAME = "imported"
REFERENCES = ("LiDAR", "truth", "sparse", "stereo")
"""What measures depth, the surest first."""
UNITS = ("m", "cm", "mm", "1/256", "1/5000")


def judge_imported(maps: Sequence[tuple[Frame, FloatMap]], unit: float) -> list[Finding]:
    """Compare maps, metres, with what else measures depth in their frames: one finding.

    Args:
        maps: frames with their imported depth (height, width), metres.
        unit: what one in the files was taken for, metres.
    """
    samples = [Sample(frame) for frame, _ in maps]
    trusted = yield_into([], judge_stereo(samples))
    for sample, (_, depth_m) in zip(samples, maps, strict=True):
        sample.trusts_stereo = trusted
        sample.depths[NAME] = depth_m
    compared = next((found for name in REFERENCES if (found := compare(samples, NAME, name)) is not None), None)
    if compared is None:
        return [Finding("note", NAME, "their scale is not checked: it needs a LiDAR, true depth or a stereo pair")]
    return [_judge(compared, unit)]


def _judge(compared: Comparison, unit: float) -> Finding:
    """Say what a comparison means."""
    reference = compared.reference if compared.reference not in ("truth", "sparse") else f"the {compared.reference}"
    text = f"median deviation from {reference} {compared.deviation:.1%} of the depth ({len(compared.depth_m)} pixels)"
    if compared.is_disparity:
        return Finding("fatal", NAME, f"{text}: near is far in them: --kind disparity, or --kind inverse")
    if compared.is_scaled:
        scale = f"their depth is {three_digits(compared.ratio)} times that of {reference}"
        return Finding("fatal", NAME, f"{scale}: --unit {_unit(unit / compared.ratio)}")
    if compared.deviation > BAD:
        return Finding("fatal", NAME, f"{text}: of other frames, of another camera, mirrored, or of no scale?")
    if compared.is_along_rays:
        return Finding("warning", NAME, f"{text}, more at the image's edges: distances along the rays? --kind range")
    return Finding("warning" if compared.deviation > OFF else "ok", NAME, text)


def _unit(metres: float) -> str:
    """Name the unit that fits: one of the usual ones where one is near, else the number."""
    known = {name: float(Fraction({"m": "1", "cm": "1/100", "mm": "1/1000"}.get(name, name))) for name in UNITS}
    off, name = min((abs(float(np.log(metres / value))), name) for name, value in known.items())
    return name if off < NEAR else three_digits(metres)
