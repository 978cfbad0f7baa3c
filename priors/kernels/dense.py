"""A dense network over many pixels: small rules that need no matrix library."""

from collections.abc import Sequence

import numpy as np

from priors.machine import threads
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

STRETCH = 512
"""Pixels that pass the whole network at a time: what its layers say of them stays in the fast caches."""
BLOCK = 4
"""Inputs and outputs of a layer that are taken at once: each line is read and written so many times less often."""


def dense(values: FloatMap, layers: Sequence[tuple[FloatMap, FloatMap]]) -> FloatMap:
    """Return the answer (outputs, n) of a dense network, ReLU between its layers, to values (inputs, n).

    A layer is its weights (inputs, outputs) and bias (outputs,). A matrix library does this no faster, and its threads
    would spin on for longer than the rest of the method takes.
    """
    weights = tuple(np.ascontiguousarray(weight) for weight, _ in layers)
    biases = tuple(bias for _, bias in layers)
    out = np.empty((biases[-1].size, values.shape[1]), np.float32)
    each_ns = 0.06 * sum(weight.size for weight in weights)
    block = -(-threads.worth(each_ns) // STRETCH) * STRETCH
    threads.over(values.shape[1], lambda first, last: _pass(values, weights, biases, out, first, last), block)
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _pass(
    values: FloatMap,
    weights: tuple[FloatMap, ...],
    biases: tuple[FloatMap, ...],
    out: FloatMap,
    first: int,
    last: int,
) -> None:
    widest = values.shape[0]
    for bias in biases:
        widest = max(widest, bias.size)
    source, target = np.empty((widest, STRETCH), np.float32), np.empty((widest, STRETCH), np.float32)
    for start in range(first, last, STRETCH):
        size = min(last - start, STRETCH)
        for i in range(values.shape[0]):
            source[i, :size] = values[i, start : start + size]
        for k in range(len(weights)):
            _layer(source, weights[k], biases[k], target, size)
            source, target = target, source
            if k < len(weights) - 1:
                _cut(source, biases[k].size, size)
        for j in range(out.shape[0]):
            out[j, start : start + size] = source[j, :size]


@compiled(fastmath=FAST, error_model="numpy")
def _layer(source: FloatMap, weights: FloatMap, bias: FloatMap, target: FloatMap, size: int) -> None:
    """Write weights.T @ source + bias of the first `size` columns."""
    inputs, outputs = weights.shape
    for j in range(outputs):
        target[j, :size] = bias[j]
    fours = inputs // BLOCK * BLOCK
    for j in range(0, outputs // BLOCK * BLOCK, BLOCK):
        for i in range(0, fours, BLOCK):
            _block(source, weights, target, i, j, size)
        for i in range(fours, inputs):
            for k in range(j, j + BLOCK):
                _line(source[i, :size], weights[i, k], target[k, :size])
    for j in range(outputs // BLOCK * BLOCK, outputs):
        for i in range(inputs):
            _line(source[i, :size], weights[i, j], target[j, :size])


@compiled(fastmath=FAST, error_model="numpy")
def _block(source: FloatMap, weights: FloatMap, target: FloatMap, i: int, j: int, size: int) -> None:
    """Add what BLOCK inputs from i on give BLOCK outputs from j on."""
    w, x, y, z = source[i, :size], source[i + 1, :size], source[i + 2, :size], source[i + 3, :size]
    p, q, r, s = target[j, :size], target[j + 1, :size], target[j + 2, :size], target[j + 3, :size]
    a, b, c, d = weights[i, j : j + 4], weights[i + 1, j : j + 4], weights[i + 2, j : j + 4], weights[i + 3, j : j + 4]
    a0, a1, a2, a3, b0, b1, b2, b3 = a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]
    c0, c1, c2, c3, d0, d1, d2, d3 = c[0], c[1], c[2], c[3], d[0], d[1], d[2], d[3]
    for n in range(size):
        one, two, three, four = w[n], x[n], y[n], z[n]
        p[n] += a0 * one + b0 * two + c0 * three + d0 * four
        q[n] += a1 * one + b1 * two + c1 * three + d1 * four
        r[n] += a2 * one + b2 * two + c2 * three + d2 * four
        s[n] += a3 * one + b3 * two + c3 * three + d3 * four


@compiled(fastmath=FAST, error_model="numpy")
def _line(source: FloatMap, weight: float, target: FloatMap) -> None:
    for n in range(source.size):
        target[n] += weight * source[n]


@compiled(fastmath=FAST, error_model="numpy")
def _cut(values: FloatMap, rows: int, size: int) -> None:
    """Leave nothing below zero."""
    for j in range(rows):
        line = values[j, :size]
        for n in range(size):
            line[n] = np.float32(0) if line[n] < 0 else line[n]
