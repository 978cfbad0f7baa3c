"""Pareto front: the methods that no other beats in both time and error."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Worth:
    """What counts of a way to make depth: less is better, but for the density."""

    seconds: float
    error: float
    density: float
    """Share of the truth's pixels that have a value: a sparser map is not better for leaving the hard ones out."""

    def beats(self, other: "Worth") -> bool:
        """Tell whether this is no worse in anything, and better in something. NaN beats nothing."""
        mine = -self.seconds, -self.error, self.density
        theirs = -other.seconds, -other.error, other.density
        return all(a >= b for a, b in zip(mine, theirs, strict=True)) and mine != theirs


def on_front(worths: Sequence[Worth]) -> list[bool]:
    """Tell of each whether no other beats it; what has no error is on no front."""
    return [
        worth.error == worth.error and not any(other.beats(worth) for other in worths)  # NaN is unequal to itself
        for worth in worths
    ]
