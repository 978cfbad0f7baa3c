"""Files of poses: a pose a line, with the id of its frame before it or without."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np

from priors.errors import DataError
from priors.frame_ids import joined
from priors.text import Line, read_lines
from priors.types import Matrix

Key = TypeVar("Key")
WITH_ID = 13
"""Words of a line: an id, and a row-major (3, 4)."""


def read_pose_lines(path: Path) -> list[Line]:
    """Read the lines from the first pose to the last; an empty one between them stands for a pose that is not there."""
    lines = read_lines(path)
    filled = [n for n, line in enumerate(lines) if line.text]
    return lines[filled[0] : filled[-1] + 1] if filled else []


def parse_pose(line: str, where: str) -> Matrix:
    """Turn 12 numbers, a row-major (3, 4), into a pose (4, 4); `where` names file and line in the error."""
    try:
        numbers = np.array([float(word) for word in line.split()])
    except ValueError as error:
        raise DataError(f"{where}: not 12 numbers: {line.strip()[:40]!r}: repair it or leave the frame out") from error
    if numbers.size != 12 or not np.isfinite(numbers).all():
        wrong = f"{numbers.size} numbers" if numbers.size != 12 else "NaN or inf"
        raise DataError(f"{where}: a pose should be 12 finite numbers, found {wrong}: repair it or leave the frame out")
    T = np.eye(4)
    T[:3] = numbers.reshape(3, 4)
    return T


def by_id(lines: Iterable[Line], ids: Iterable[str], path: Path) -> dict[str, Line] | None:
    """Return each frame's line without the id that begins it; None where not all lines begin with one.

    Ids are joined as files are: as text, or as numbers where both are numbers (numpy writes 7 as 7.000e+00).

    Raises:
        DataError: two lines are of one frame.
    """
    own = set(ids)
    named: dict[str, Line] = {}
    for line in lines:
        words = line.words
        if len(words) != WITH_ID:
            return None
        name = words[0] if words[0] in own else _whole_number(words[0])
        if name in named:
            raise DataError(f"{path}: lines {named[name].number} and {line.number} are both of frame {name}: drop one")
        named[name] = Line(line.number, " ".join(words[1:]))
    return joined(own, named)


def _whole_number(word: str) -> str:
    """Return a whole number's digits, however it is written; any other word as it is."""
    if word.isdecimal():
        return word
    try:
        return str(int(number)) if (number := float(word)).is_integer() and number >= 0 else word
    except (ValueError, OverflowError):
        return word


def readable(keys: Iterable[Key], pose_of: Callable[[Key], Matrix | None]) -> dict[Key, Matrix]:
    """Return the poses that are there and can be read, by their keys: a damaged one spoils its own frame only."""
    poses = {}
    for key in keys:
        with suppress(DataError):
            if (pose := pose_of(key)) is not None:
                poses[key] = pose
    return poses
