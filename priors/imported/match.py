"""Which imported file belongs to which frame, by their names."""

import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path

from priors.drives import stems
from priors.errors import DataError
from priors.frame_ids import joined

SUFFIXES = (".png", ".npy", ".npz", ".pfm")


def match(ids: Sequence[str], folder: Path) -> dict[str, Path]:
    """Map frame id to file, in the order of the ids.

    Equal names come first, and numbers with other zeros before them. Where no file is joined so, what all files, and
    all ids, begin and end with is left out: `0000000005_disp.png` and `depth_5.npy` belong to 0000000005.

    Raises:
        DataError: there is no folder, no map in it, or none of a frame.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder: --depth names the folder of the maps")
    files = stems(folder, SUFFIXES)
    if not files:
        raise DataError(f"{folder}: no depth maps ({', '.join(SUFFIXES)}): --depth names the folder that holds them")
    cores, bare = _cores(list(files)), _cores(list(ids))
    ways = (
        (dict.fromkeys(ids), files),
        (dict.fromkeys(ids), {cores[stem]: path for stem, path in files.items()}),
        ({bare[id_]: id_ for id_ in ids}, {cores[stem]: path for stem, path in files.items()}),
    )
    for names, paths in ways:
        named = {(names[name] or name): path for name, path in joined(names, paths).items() if name in names}
        if named:
            return {id_: named[id_] for id_ in ids if id_ in named}
    some = ", ".join(list(files)[:3])
    raise DataError(f"{folder}: no map of a frame: frames are named {', '.join(ids[:3])}, maps {some}: rename them")


def _cores(names: Sequence[str]) -> Mapping[str, str]:
    """Return each name without what all begin and end with, but for digits; as it is where nothing would be left."""
    if len(names) == 1:  # what stands around its first number
        found = re.search(r"\d+", names[0])
        return {names[0]: names[0] if found is None else found.group()}
    before = re.sub(r"\d+$", "", _start(names))
    after = re.sub(r"^\d+", "", _start([name[::-1] for name in names])[::-1])
    cores = {name: name[len(before) : len(name) - len(after)] for name in names}
    return cores if all(cores.values()) and len(set(cores.values())) == len(cores) else {name: name for name in names}


def _start(names: Sequence[str]) -> str:
    """Return what all names begin with."""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in alike)
