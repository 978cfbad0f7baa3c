"""Train-test split: the study's rule, on positions in the drive."""

import re

from priors.errors import DataError, UsageError, expect

EVERY_HELD_OUT = 10
SPARSE_STEP = 4
"""Sparse views are every 4th where nothing else is known: 2.5 Hz of a drive at 10 Hz."""
HELD_OUT = "held-out"
"""The training views of a ceiling."""
SHARE = re.compile(r"1/([1-9][0-9]{0,8})")
NUMBER = re.compile(r"0*[1-9][0-9]{0,8}")
CHOICES = "dense, sparse, a share such as 1/8, or a number from 1 on"


def check_views(views: str) -> None:
    """Raise UsageError where a text names no training views: dense, sparse, held-out, a share 1/N or a number."""
    named = views in ("dense", "sparse", HELD_OUT)
    expect(
        named or bool(SHARE.fullmatch(views) or NUMBER.fullmatch(views)),
        "--views",
        (views if len(views) < 40 else f"{views[:40]}...") or "''",
        CHOICES,
    )


def in_name(views: str) -> str:
    """Return how the name of a folder says which views train: 1of8 for 1/8."""
    return views.replace("/", "of")


def held_out(count: int) -> list[int]:
    """Return the held-out positions among `count` frames: 9, 19, ..."""
    return list(range(EVERY_HELD_OUT - 1, count, EVERY_HELD_OUT))


def split(count: int, views: str, sparse_step: int | None = None) -> tuple[list[int], list[int]]:
    """Part `count` frames into training and held-out positions.

    Every 10th frame is held out (positions 9, 19, ...). Of the rest, 'dense' trains on all, 'sparse' on every 4th
    (the study's 2.5 Hz at 10 Hz) or every `sparse_step`-th, 1/N on every N-th, and a number N on N of them, evenly
    spread. 'held-out' trains on the held-out frames themselves: the ceiling of what a field can show of them, and no
    result.

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
        return rest[:: sparse_step or SPARSE_STEP], test
    check_views(views)
    wanted = int(views.removeprefix("1/"))
    if wanted > len(rest):
        most = f"a share from 1/1 to 1/{len(rest)}" if "/" in views else f"a number from 1 to {len(rest)}"
        raise UsageError(f"--views {views}: expected dense, sparse or {most}")
    if "/" in views:
        return rest[::wanted], test
    return [rest[(2 * i + 1) * len(rest) // (2 * wanted)] for i in range(wanted)], test
