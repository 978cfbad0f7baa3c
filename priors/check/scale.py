"""Scales: what a factor between two measurements of one scene is likely to come from."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

NEAR = 0.13
"""A factor's logarithm may be off by so much and still have a name: stereo and images measure to a few per cent."""
Factors: TypeAlias = Sequence[tuple[float, str]]

MAP_FACTORS: Factors = (
    (1000 / 256, "a PNG of millimetres is read so (it should hold metres x 256): multiply its numbers by 0.256"),
    (256 / 1000, "metres x 256 were taken for millimetres: multiply its numbers by 3.90625"),
    (256, "its metres are multiplied by 256 where no PNG asks for it, or twice: divide by 256"),
    (1 / 256, "a PNG of whole metres is read so (it should hold metres x 256): multiply its numbers by 256"),
    (100 / 256, "a PNG of centimetres is read so (it should hold metres x 256): multiply its numbers by 2.56"),
    (256 / 100, "metres x 256 were taken for centimetres: divide its numbers by 2.56"),
    (5000 / 256, "a PNG of metres x 5000 is read so (it should hold metres x 256): multiply its numbers by 0.0512"),
    (1000, "it holds millimetres: divide by 1000"),
    (1 / 1000, "it holds kilometres, or was divided by 1000 twice: multiply by 1000"),
    (100, "it holds centimetres: divide by 100"),
    (1 / 100, "it was divided by 100: multiply by 100"),
)
POSE_FACTORS: Factors = (
    (1000, "they are in millimetres: divide translations by 1000"),
    (100, "they are in centimetres: divide translations by 100"),
    (1 / 1000, "they are in kilometres: multiply translations by 1000"),
    (3.2808, "they are in feet: multiply translations by 0.3048"),
)


def name_factor(factor: float, factors: Factors) -> str:
    """Say what a factor comes from and what to do; a factor of no name is told as what to multiply by."""
    off, cause = min((abs(float(np.log(factor / known))), cause) for known, cause in factors)
    if off < NEAR:
        return cause
    return f"are they metres? if not, multiply by {three_digits(1 / factor)}"


def three_digits(number: float) -> str:
    """Return a number with its first three digits, never as a power of ten."""
    return np.format_float_positional(float(f"{number:.3g}"), trim="-")
