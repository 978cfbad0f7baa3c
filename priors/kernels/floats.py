"""bfloat16 inside kernels, as unsigned integers since numpy has no such type; and an exponential that vectorises.

A kernel sees a float32 array as uint32 and a bfloat16 one as uint16: the upper half of a float32's bits.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

Bits = npt.NDArray[np.unsignedinteger[Any]]
LOG2_E = np.float32(1.4426950408889634)
LN_2 = np.float32(0.6931471805599453)


@compiled(fastmath=FAST)
def widen(bits: Bits, out: FloatMap) -> None:
    """Write numbers (n,), stored in 16 or 32 bits, as float32."""
    shift = np.uint32(32 - 8 * bits.itemsize)
    whole = out.view(np.uint32)
    for k in range(bits.size):
        whole[k] = np.uint32(bits[k]) << shift


@compiled(fastmath=FAST)
def narrow(values: FloatMap, out: Bits) -> None:
    """Store float32 numbers (n,) in 16 bits, rounded to the nearest even, or as they are in 32."""
    shift = np.uint32(32 - 8 * out.itemsize)
    half, odd = np.uint32(0x7FFF) * (shift >> np.uint32(4)), shift >> np.uint32(4)
    whole = values.view(np.uint32)
    for k in range(values.size):
        out[k] = (whole[k] + half + ((whole[k] >> shift) & odd)) >> shift


@compiled(fastmath=FAST)
def exponentiate(values: FloatMap, scratch: FloatMap) -> None:
    """Replace numbers (n,) between -80 and 80 by their exponentials, to 4e-7 of each; scratch is as large.

    2^n is put together from bits, the rest is e^r = (e^(r / 2))^2 by its series: no call, so loops become vectors.
    """
    power = scratch.view(np.int32)
    for k in range(values.size):
        whole = np.floor(values[k] * LOG2_E + np.float32(0.5))
        r = (values[k] - whole * LN_2) * np.float32(0.5)
        power[k] = (np.int32(whole) + np.int32(127)) << np.int32(23)
        series = np.float32(1 / 120) + r * np.float32(1 / 720)
        series = np.float32(1 / 6) + r * (np.float32(1 / 24) + r * series)
        series = np.float32(1) + r * (np.float32(1) + r * (np.float32(0.5) + r * series))
        values[k] = series * series
    for k in range(values.size):
        values[k] *= scratch[k]
