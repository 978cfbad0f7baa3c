"""Adam on the CPU: one pass over weights, gradient and running means, that leaves the rounded copy too."""

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import (
    floats,
    fma,
    larger,
    load_floats,
    root,
    round_bfloat,
    smaller,
    store,
    store_halves,
)
from nerf.types import STEEPEST
from priors.machine.compiled import compiled

Numbers = npt.NDArray[np.float32]


@compiled
def _sixteen(weights, gradient, mean, square, copy, i, settings):  # type: ignore[no-untyped-def]
    beta_mean, beta_square, rate, inverse, epsilon = settings
    one = np.float32(1)
    steepest = np.float32(STEEPEST)
    g = smaller(floats(steepest), larger(floats(-steepest), load_floats(gradient, i)))  # NaN stays
    m = fma(floats(one - beta_mean), g - load_floats(mean, i), load_floats(mean, i))
    s = fma(floats(beta_square), load_floats(square, i), floats(one - beta_square) * (g * g))
    w = load_floats(weights, i) - floats(rate) * m / (root(s * floats(inverse)) + floats(epsilon))
    store(mean, i, m)
    store(square, i, s)
    store(weights, i, w)
    if copy.size:
        store_halves(copy, i, round_bfloat(w))


@compiled
def adam(
    weights: Numbers,
    gradient: Numbers,
    mean: Numbers,
    square: Numbers,
    copy: npt.NDArray[np.int16],
    settings: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    first: int,
    last: int,
) -> None:
    """Move flat weights first to last along their gradient; `copy` is their bfloat16 bits, or empty.

    settings: beta of the mean and of the square, rate / (1 - beta_mean^step), 1 / (1 - beta_square^step), epsilon.
    """
    for i in range(first, last - 15, 16):
        _sixteen(weights, gradient, mean, square, copy, i, settings)
    rest = last - (last - first) % 16
    if rest < last:  # the tail, filled up
        tail = last - rest
        padded = np.zeros((4, 16), dtype=np.float32)
        half = np.zeros(16, dtype=np.int16)
        for i in range(tail):  # an assignment of slices would take seconds to compile, for the texts of its errors
            padded[0, i], padded[1, i] = weights[rest + i], gradient[rest + i]
            padded[2, i], padded[3, i] = mean[rest + i], square[rest + i]
        _sixteen(padded[0], padded[1], padded[2], padded[3], half, np.int64(0), settings)
        for i in range(tail):
            weights[rest + i], mean[rest + i], square[rest + i] = padded[0, i], padded[2, i], padded[3, i]
            if copy.size:
                copy[rest + i] = half[i]
