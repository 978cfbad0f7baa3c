"""Adam for the Gaussians in view, compiled: rows of a few numbers, wherever they lie. Equals nerf/twin/adam.py."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import floats, fma, larger, root, smaller
from nerf.kernels.cpu.splat_lanes import load_some, store_some
from nerf.types import STEEPEST
from priors.machine.compiled import compiled

Numbers = npt.NDArray[np.float32]


class Columns(NamedTuple):
    """Some columns of a parameter of n Gaussians and of the v that have gradients, flat."""

    parameter: Numbers
    mean: Numbers
    """Of the gradients."""
    square: Numbers
    """Of their squares."""
    gradient: Numbers
    stored: int
    """Columns that the parameter has ..."""
    given: int
    """... and that the gradient has."""
    first: int
    """The columns that are moved: from ..."""
    last: int
    """... up to, but without."""


class Settings(NamedTuple):
    """A step's numbers."""

    beta_mean: np.float32
    beta_square: np.float32
    scale_mean: np.float32
    """1 / (1 - beta_mean^step)"""
    scale_square: np.float32
    epsilon: np.float32


@compiled
def adam(
    columns: Columns, index: npt.NDArray[np.int64], rate: np.float32, unit: Numbers, settings: Settings, first: int,
    last: int,
) -> None:  # fmt: skip
    """Move the rows index[first] to index[last - 1]; the rate is times the row's unit (n,), where that is not empty."""
    one, steepest = np.float32(1), np.float32(STEEPEST)
    for k in range(first, last):
        i = index[k]
        pace = rate * settings.scale_mean * (unit[i] if len(unit) else one)
        for column in range(columns.first, columns.last, 16):
            count = min(16, columns.last - column)
            at = np.int64(columns.stored) * i + column
            g = load_some(columns.gradient, np.int64(columns.given) * k + column, np.int64(count))
            g = larger(floats(-steepest), smaller(floats(steepest), g))  # in this order NaN stays NaN
            m, s = load_some(columns.mean, at, np.int64(count)), load_some(columns.square, at, np.int64(count))
            m = fma(floats(one - settings.beta_mean), g - m, m)
            s = fma(floats(settings.beta_square), s, floats(one - settings.beta_square) * (g * g))
            w = load_some(columns.parameter, at, np.int64(count))
            w = w - floats(pace) * m / (root(s * floats(settings.scale_square)) + floats(settings.epsilon))
            store_some(columns.mean, at, np.int64(count), m)
            store_some(columns.square, at, np.int64(count), s)
            store_some(columns.parameter, at, np.int64(count), w)


@compiled
def straighten(rotations: Numbers, index: npt.NDArray[np.int64], first: int, last: int) -> None:
    """Make the quaternions of some Gaussians as long as 1."""
    for k in range(first, last):
        at, squared = 4 * index[k], np.float32(0)
        for axis in range(4):
            squared += rotations[at + axis] * rotations[at + axis]
        if squared > 0:
            for axis in range(4):
                rotations[at + axis] /= np.sqrt(squared)
