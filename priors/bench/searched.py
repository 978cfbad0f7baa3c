"""How far stereo must search on a drive: most of its time grows with the largest disparity."""

from statistics import median

from priors.codecs import as_grey
from priors.pairs.matching import find_max_disparity
from priors.types import Drive, Frame

FRAMES = 5
"""A frame's quarter-size match takes some 10 ms."""


def searched(frame: Frame) -> float | None:
    """Return the largest disparity of a frame as a share of its width; None without a pair."""
    other = frame.other() if frame.has("other") else None
    if other is None:
        return None
    left, right = as_grey(frame.image()), as_grey(other)
    if frame.side == "right":
        left, right = right, left
    return find_max_disparity(left, right) / left.shape[1] if left.shape == right.shape else None


def usual(drive: Drive) -> float | None:
    """Return the median of frames that are spread over a drive; None where none has a pair."""
    step = max(1, len(drive) // FRAMES)
    found = [share for index in range(0, len(drive), step) if (share := searched(drive[index])) is not None]
    return median(found) if found else None
