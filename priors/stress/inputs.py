"""Inputs of the stress tables: what numbers a routine is given. A third of the places hold the extreme ones.

Mixed in among usual numbers an extreme one tells more than alone: what it must not touch is seen too.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from priors.stress.precision import Floats, Precision

EXTREME_SHARE = 1 / 3
FAR_M = 5e5
"""How far from the world's origin maps put a street, metres."""


@dataclass(frozen=True, slots=True)
class Input:
    """A row of the table."""

    name: str
    what: str
    """In words, for the page."""
    extreme: Callable[[Precision], tuple[float, ...]] | None = None
    """The extreme numbers; None: none of them is."""


def _only(*values: float) -> Callable[[Precision], tuple[float, ...]]:
    return lambda precision: values


USUAL = Input("usual", "what the routine meets on a street")
ONE_PIXEL = Input("one pixel", "a map of one pixel, a list of one entry")
EMPTY = Input("empty mask", "no value anywhere, or no pixel with a truth")
CONSTANT = Input("constant", "all values are equal")
FAR = Input("poses 5e5 m", "poses as far from the world's origin as in maps' coordinates")
NOT_A_NUMBER = Input("NaN", "values that are no numbers", _only(np.nan))
INFINITE = Input("inf", "infinite values", _only(np.inf))

INPUTS = (
    USUAL,
    Input("0", "zeros", _only(0.0)),
    Input("denormals", "the smallest numbers that the type holds", lambda precision: (3 * precision.smallest,)),
    Input("65504", "float16's largest number", _only(65504.0)),
    Input("1e30", "numbers whose square float32 cannot hold; infinite in float16", _only(1e30)),
    INFINITE,
    NOT_A_NUMBER,
    EMPTY,
    ONE_PIXEL,
    CONSTANT,
    Input("1e-3 m", "a depth of a millimetre", _only(1e-3)),
    Input("1e6 m", "a depth of a thousand kilometres; infinite in float16", _only(1e6)),
    FAR,
)


@dataclass(frozen=True, slots=True)
class Given:
    """An input at a precision: makes the numbers that a routine is tested with."""

    input: Input
    precision: Precision
    random: np.random.Generator

    def size(self, *usual: int) -> tuple[int, ...]:
        """Return the size of a map: the usual one, or one pixel."""
        return (1,) * len(usual) if self.input is ONE_PIXEL else usual

    def plain(self, low: float, high: float, size: tuple[int, ...], signed: bool = False) -> Floats:
        """Return usual numbers, as many decades each from low to high, as the precision holds them."""
        if self.input is CONSTANT:
            values = np.full(size, np.sqrt(low * high))
        else:
            values = np.exp(self.random.uniform(np.log(low), np.log(high), size))
        if signed:
            values = values * self.random.choice([-1.0, 1.0], size)
        return self.precision.rounded(values)

    def values(self, low: float, high: float, size: tuple[int, ...], signed: bool = False) -> Floats:
        """Return the input's numbers: usual ones with the extreme ones among them; none where the mask is empty."""
        values = self.plain(low, high, size, signed)
        if self.input is EMPTY:
            return np.zeros(size)
        if self.input.extreme is not None:
            chosen = self.random.choice(self.input.extreme(self.precision), size)
            if signed:
                chosen = chosen * self.random.choice([-1.0, 1.0], size)
            values = np.where(self.random.random(size) < EXTREME_SHARE, chosen, values)
        return self.precision.rounded(values)

    def mask(self, share: float, size: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        """Return a mask with this share of true pixels; the empty one has none."""
        return np.asarray(self.random.random(size) < (0 if self.input is EMPTY else share))

    @property
    def far(self) -> Any:
        """Where the world is moved to: (3,) metres."""
        return np.array([0.91, -0.4, 0.002]) * FAR_M if self.input is FAR else np.zeros(3)
