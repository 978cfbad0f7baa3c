"""Times: do they rise evenly, allowing for frames that were left out?"""

from collections.abc import Iterator, Sequence

import numpy as np

from priors.check.finding import Finding
from priors.types import Frame


def judge_times(frames: Sequence[Frame]) -> Iterator[Finding]:
    """Judge the frames' times."""
    stamped = [(int(f.id) if f.id.isdecimal() else None, f.time_s) for f in frames if f.time_s is not None]
    if len(stamped) < 2:
        yield Finding("note", "times", "no timestamps: 10 Hz is assumed")
        return
    gaps_s = np.diff(np.array([time for _, time in stamped]))
    numbers = [number for number, _ in stamped]
    if all(number is not None and number < 10**9 for number in numbers):
        gaps_s = gaps_s / np.diff(np.array(numbers))
    usual = float(np.median(gaps_s))
    if (gaps_s <= 0).any():
        first = [frame.id for frame in frames if frame.time_s is not None][int(np.argmax(gaps_s <= 0)) + 1]
        yield Finding("fatal", "times", f"times do not rise at frame {first}: are the timestamps of another drive?")
        return
    long = np.count_nonzero(gaps_s > 1.5 * usual)
    text = f"{1 / usual:.1f} Hz" + (f", {long} pauses, up to {gaps_s.max():.2f} s" if long else "")
    yield Finding("warning" if long else "ok", "times", text)
