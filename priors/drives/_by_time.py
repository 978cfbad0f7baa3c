"""Files by time: names that end in a time, the file nearest to a moment, and a pose between two others."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from priors.drives._files import stems
from priors.geometry import invert
from priors.types import Matrix


def by_time(folder: Path, suffixes: Iterable[str]) -> dict[int, Path]:
    """Map nanoseconds, the digits that end a file's name, to the file, in time order."""
    times = {}
    for stem, path in stems(folder, suffixes).items():
        digits = stem.rpartition("_")[2]
        if digits.isdecimal():
            times[int(digits)] = path
    return dict(sorted(times.items()))


def nearest(times: Sequence[int], time: int, within: int) -> int | None:
    """Return the nearest of the sorted times, None where it is farther than `within`; the earlier one in a tie."""
    after = bisect_left(times, time)
    around = times[max(after - 1, 0) : after + 1]
    best = min(around, key=lambda t: abs(t - time), default=None)
    return None if best is None or abs(best - time) > within else best


def beside(times: Sequence[int], time: int, within: int, offset: int) -> int | None:
    """Return the time that lies `offset` places from the nearest of the sorted times; None where there is none."""
    first = nearest(times, time, within)
    if first is None:
        return None
    index = bisect_left(times, first) + offset
    return times[index] if 0 <= index < len(times) else None


def at_time(times: Sequence[int], pose: Callable[[int], Matrix], time: int, within: int) -> Matrix | None:
    """Return the pose (4, 4) at a time, by those at the sorted times: `pose(i)` is the one at times[i].

    Between two it is interpolated. It is None before the first, after the last, and between two that are farther apart
    than `within`.
    """
    after = bisect_left(times, time)
    if after < len(times) and times[after] == time:
        return pose(after)
    if not 0 < after < len(times) or times[after] - times[after - 1] > within:
        return None
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    return between(pose(after - 1), pose(after), share)


def between(T_world_a: Matrix, T_world_b: Matrix, share: float) -> Matrix:
    """Return the pose (4, 4) a share of the way from one pose to another, turning about one axis."""
    T_a_b = invert(T_world_a) @ T_world_b
    T_a_time = np.eye(4)
    T_a_time[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(T_a_b[:3, :3]).as_rotvec()).as_matrix()
    T_a_time[:3, 3] = share * T_a_b[:3, 3]
    return T_world_a @ T_a_time
