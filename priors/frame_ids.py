"""Frame ids: their order, and how files are joined to frames by them. Those of digits only are numbers."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from decimal import Decimal
from typing import TypeVar

Kind = TypeVar("Kind")


def in_order(ids: Iterable[str]) -> list[str]:
    """Sort frame ids: numbers first, 9 before 10; then names, numbers in them too, img9 before img10."""
    return sorted(ids, key=_rank)


def _rank(id_: str) -> tuple[int, Decimal, list[str | int], str]:
    """Return what an id is sorted by; 1305031102.5 is one number, a time."""
    if re.fullmatch(r"\d+(\.\d+)?", id_):
        return 0, Decimal(id_), [], id_
    return 1, Decimal(0), [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", id_)], id_


def joined(ids: Iterable[str], paths: Mapping[str, Kind]) -> dict[str, Kind]:
    """Return files by the frame ids that they belong to: by equal stems, and 7 with 000007 where both are numbers.

    A number that several files or several ids have is joined by equal stems only. Files of no frame keep their stem.
    """
    own = set(ids)
    of_ids, of_files = sole_numbers(own), sole_numbers(paths)
    named = {}
    for stem, path in paths.items():
        number = int(stem) if stem.isdecimal() else -1
        alike = stem not in own and of_files.get(number) == stem
        named[of_ids.get(number, stem) if alike else stem] = path
    return named


def by_number(ids: Iterable[str]) -> dict[int, str]:
    """Map number to id, for the ids of digits only; of several with one number it is the last."""
    return {int(id_): id_ for id_ in ids if id_.isdecimal()}


def sole_numbers(ids: Iterable[str]) -> dict[int, str]:
    """Map number to id, for the ids of digits only that are the only ones with their number."""
    digits = [id_ for id_ in ids if id_.isdecimal()]
    counts = Counter(map(int, digits))
    return {int(id_): id_ for id_ in digits if counts[int(id_)] == 1}
