"""Dense layers over many pixels: small rules that need no matrix library."""

from priors.machine import threads
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

STRETCH = 512
"""Values that a dense layer takes at a time: its line stays in the fastest cache."""


def dense(values: FloatMap, weights: FloatMap, bias: FloatMap, out: FloatMap) -> None:
    """Write a dense layer's answer weights.T @ values + bias (outputs, n) for values (inputs, n).

    A matrix library does this no faster, and its threads would spin on for longer than the rest of the method takes.
    """
    each_ns = 0.1 * weights.size
    block = -(-threads.worth(each_ns) // STRETCH) * STRETCH
    threads.over(values.shape[1], lambda first, last: _dense(values, weights, bias, out, first, last), block)


@compiled(fastmath=FAST, error_model="numpy")
def _dense(values: FloatMap, weights: FloatMap, bias: FloatMap, out: FloatMap, first: int, last: int) -> None:
    fours = weights.shape[0] // 4 * 4
    for start in range(first, last, STRETCH):
        end = min(last, start + STRETCH)
        for j in range(weights.shape[1]):
            line = out[j, start:end]
            line[:] = bias[j]
            for i in range(0, fours, 4):  # four at a time: the line is read and written a quarter as often
                a, b, c, d = weights[i, j], weights[i + 1, j], weights[i + 2, j], weights[i + 3, j]
                one, two = values[i, start:end], values[i + 1, start:end]
                three, four = values[i + 2, start:end], values[i + 3, start:end]
                for n in range(end - start):
                    line[n] += a * one[n] + b * two[n] + c * three[n] + d * four[n]
            for i in range(fours, weights.shape[0]):
                a, one = weights[i, j], values[i, start:end]
                for n in range(end - start):
                    line[n] += a * one[n]
