"""Train-test split: the study's rule, on positions in the drive."""

from priors.errors import DataError, UsageError, expect

EVERY_HELD_OUT = 10
SPARSE_STEP = 4
HELD_OUT = "held-out"
"""The training views of a ceiling."""


def check_views(views: str) -> None:
    """Raise UsageError where a text names no training views: dense, sparse, held-out or a number from 1 on."""
    number = views.isdecimal() and int(views) >= 1
    expect(
        number or views in ("dense", "sparse", HELD_OUT),
        "--views",
        views or "''",
        "dense, sparse or a number from 1 on",
    )


def held_out(count: int) -> list[int]:
    """Return the held-out positions among `count` frames: 9, 19, ..."""
    return list(range(EVERY_HELD_OUT - 1, count, EVERY_HELD_OUT))


def split(count: int, views: str) -> tuple[list[int], list[int]]:
    """Part `count` frames into training and held-out positions.

    Every 10th frame is held out (positions 9, 19, ...). Of the rest, 'dense' trains on all, 'sparse' on every 4th
    (the study's 2.5 Hz), and a number N on N of them, evenly spread. 'held-out' trains on the held-out frames
    themselves: the ceiling of what a field can show of them, and no result.

    Returns:
        training positions, held-out positions.

    Raises:
        UsageError: views is none of these, or more frames are asked for than there are.
        DataError: there is no frame to train on.
    """
    test = held_out(count)
    rest = [position for position in range(count) if position not in set(test)]
    if not rest:
        raise DataError("no frames to train on: choose more with --frames")
    if views == HELD_OUT:
        if not test:
            raise UsageError(f"--views {HELD_OUT}: none of {count} frames is held out: take {EVERY_HELD_OUT} or more")
        return test, test
    if views == "dense":
        return rest, test
    if views == "sparse":
        return rest[::SPARSE_STEP], test
    check_views(views)
    if int(views) > len(rest):
        raise UsageError(f"--views {views}: expected dense, sparse or a number from 1 to {len(rest)}")
    wanted = int(views)
    return [rest[(2 * i + 1) * len(rest) // (2 * wanted)] for i in range(wanted)], test
