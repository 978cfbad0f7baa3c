"""Training frames of a drive: which of them a network is fine-tuned on, and reading them."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from priors.errors import DataError, UsageError
from priors.selection import held_out
from priors.types import Drive

Item = TypeVar("Item")
MOST_VIEWS = 40
"""Frames that take part at most, spread evenly."""


def training_views(count: int, chosen: Sequence[int], hold_out: str) -> list[int]:
    """Return which of the chosen frames may take part: those not held out.

    Args:
        count: frames of the drive, for the message.
        chosen: positions in the drive, in order.
        hold_out: start:stop:step as Python counts, over `chosen` (9::10: every 10th from the 10th on, as `nerf fit`
            holds out), a single position, or none.

    Raises UsageError for any other text, and where no frame is left.
    """
    out = held_out(chosen, hold_out)
    training = [index for index in chosen if index not in out]
    if not training:
        raise UsageError(f"--mono.hold-out {hold_out} leaves no frame of {count} to adapt on: hold out fewer")
    return training


def pick_evenly(items: Sequence[Item], most: int) -> list[Item]:
    """Return at most `most` of the items, spread evenly."""
    places = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[place] for place in places]


def read_each(drive: Drive, indices: Sequence[int], read: Callable[[int], Item], what: str) -> list[Item]:
    """Read what frames teach. Frames that raise DataError are left out; DataError where none is left."""
    views, reason = [], ""
    for index in indices:
        try:
            views.append(read(index))
        except DataError as error:
            reason = reason or str(error)
    if not views:
        raise DataError(f"{drive.name}: no {what} to adapt to in any training frame{': ' if reason else ''}{reason}")
    return views
