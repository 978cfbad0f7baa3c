"""How far stereo must search on a drive: most of its time grows with the largest disparity."""

from contextlib import suppress
from statistics import median

from priors.codecs import as_grey
from priors.errors import DataError
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
    """Return the median of frames that are spread over a drive; None where none has a pair that can be read."""
    found = []
    for index in range(0, len(drive), max(1, len(drive) // FRAMES)):
        with suppress(DataError):  # the build names the frames that it cannot read
            found.append(searched(drive[index]))
    shares = [share for share in found if share is not None]
    return median(shares) if shares else None
