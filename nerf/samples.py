"""Samples: where along each ray the field is asked, packed ray by ray, near to far."""

from dataclasses import dataclass

from torch import Tensor

BLOCK = 2048
"""The number of samples is padded to a multiple of this: matrix libraries prepare themselves anew for every shape."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Packed samples of r rays: ray i has samples offsets[i] to offsets[i + 1]; from `used` on is padding."""

    offsets: Tensor
    """(r + 1,) int64; the last is `used`."""
    ray: Tensor
    """(m,) int32 index of the sample's ray; -1 in the padding."""
    t: Tensor
    """(m,) camera-z depth of the interval's middle, metres."""
    dt_m: Tensor
    """(m,) the interval's length along the ray, metres; 0 in the padding."""
    s0: Tensor
    """(m,) start of the interval in the space's spacing coordinate, [0, 1]."""
    s1: Tensor
    """(m,) end of the interval in that coordinate."""
    u: Tensor
    """(m, 3) place in the field's grid, [0, 1]."""
    table: Tensor
    """(m,) int32: which of the field's tables holds it (0 inner, 1 outer)."""
    used: int
    """How many samples are real."""
