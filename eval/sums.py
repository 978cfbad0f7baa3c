"""Sums over pixels: what metrics are made from; two of them add, so that a mean may be over images or over pixels."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Self


@dataclass(frozen=True, slots=True)
class Sums(ABC):
    """Sums over any number of pixels."""

    def __add__(self, other: Self) -> Self:
        """Join two sets of pixels: field by field."""
        return type(self)(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    @abstractmethod
    def finish(self) -> dict[str, float]:
        """Turn the sums into metrics by key; NaN where there is nothing to average."""


def ratio_of(total: float, count: int) -> float:
    """Divide; NaN where count is 0."""
    return total / count if count else float("nan")
