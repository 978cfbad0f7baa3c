"""Which drives a command works on: folders, patterns, and lists of drives as text or Parquet.

kitti/2011_09_26/*                               a pattern, in quotes or not
kitti/                                           all drives in and below a folder
drives.txt                                       a drive a line, with flags of its own:

    streets/a --camera image_03                  # a path begins at the list's folder
    streets/b --frames 0:200 --poses recorded

drives.parquet                                   the same as columns: path, and any of FLAGS (camera, frames, ...)
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from priors import text
from priors.drives import DriveOptions
from priors.errors import DataError
from priors.places import places
from priors.selection import parse_range

OPTIONS = tuple(each.name for each in fields(DriveOptions))
FLAGS = ("dataset", *OPTIONS, "frames")
"""What a list may say of a drive, named as the flags of `priors build`."""
PATHS = ("truth", "poses_from")
"""Those of them that are folders."""


@dataclass(frozen=True)
class DriveEntry:
    """A drive as a command or a list names it; nothing of it has been read."""

    path: Path
    """Its folder."""
    dataset: str = "auto"
    """Data set; auto recognises it."""
    part: DriveOptions = DriveOptions()
    """Which camera and drive of the folder."""
    frames: str | None = None
    """Range of frames, a:b; None: all."""

    @property
    def absolute(self) -> "DriveEntry":
        """The same, for a process that works in another folder."""
        part = self.part
        truth = None if part.truth is None else part.truth.absolute()
        poses_from = part.poses_from.absolute() if part.poses == "refined" else part.poses_from
        return replace(self, path=self.path.absolute(), part=replace(part, truth=truth, poses_from=poses_from))


@dataclass(frozen=True)
class DriveList:
    """What names of drives come to."""

    entries: list[DriveEntry]
    refused: dict[str, str]
    """A name, or a line of a list -> why it is no drive."""


def find_drives(names: Sequence[Path], usual: DriveEntry) -> DriveList:
    """Find the drives that names stand for; a name that stands for none is refused, and the others go on.

    Args:
        names: folders of drives or with drives below them, patterns, and lists.
        usual: what holds for each drive of which a list says nothing else; its path is not used.
    """
    found, refused = [], {}
    for name in names:
        try:
            for told, entry in _named(name, usual):
                if isinstance(entry, DriveEntry):
                    found.append(entry)
                else:
                    refused[told] = str(entry)
        except DataError as error:
            refused[str(name)] = str(error).removeprefix(f"{name}: ")
    return DriveList(found, refused)


def stands_for_several(name: Path) -> bool:
    """Tell whether a name is a pattern or a list: more than a folder."""
    return name.is_file() or (has_magic(str(name)) and not name.exists())


def _named(name: Path, usual: DriveEntry) -> Iterator[tuple[str, DriveEntry | DataError]]:
    """Give what one name stands for, each with what it is called in an error."""
    if name.is_file():
        yield from _listed(name, usual)
        return
    folders = [name]
    if has_magic(str(name)) and not name.exists():
        folders = [path for path in map(Path, sorted(glob(str(name)))) if path.is_dir()]  # noqa: PTH207  of any root
        if not folders:
            raise DataError("no folder fits this pattern")
    for folder in folders:
        try:
            yield from ((str(entry.path), entry) for entry in _in_folder(replace(usual, path=folder)))
        except DataError as error:
            yield str(folder), error


def _in_folder(entry: DriveEntry) -> list[DriveEntry]:
    """Return the drives in and below a folder; the entry itself where it says which drive it is."""
    if entry.part.drive is not None or entry.dataset != "auto" or not entry.path.is_dir():
        return [entry]
    found = places(entry.path)
    if not found:
        return [entry]  # opening it tells what it holds instead
    return [replace(entry, path=place.path, dataset=place.dataset) for place in found]


def _listed(path: Path, usual: DriveEntry) -> Iterator[tuple[str, DriveEntry | DataError]]:
    """Give the drives of a list, each with its line."""
    for told, row in _rows(path):
        try:
            entry = _entry(row, path.parent, usual)
            yield from ((told, each) for each in _in_folder(entry))
        except DataError as error:
            yield told, error


def _rows(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Read a list's rows: what each says, by the names of FLAGS and "path"."""
    if path.suffix == ".parquet":
        for number, row in enumerate(_read_parquet(path), 1):
            yield f"{path}, row {number}", row
        return
    for line in text.read_lines(path):
        if line.text:
            yield f"{path}, line {line.number}", _flags_of(line.text)


def _flags_of(line: str) -> dict[str, Any]:
    """Take a line of a text list apart: a path and flags."""
    try:
        words = shlex.split(line)
    except ValueError as error:
        return {"path": line, "wrong": f"{error}: quote what has blanks in it"}
    row: dict[str, Any] = {"path": words[0]}
    rest = words[1:]
    while rest:
        flag, equals, value = rest.pop(0).partition("=")
        name = flag.removeprefix("--").replace("-", "_")
        if not flag.startswith("--") or not (equals or rest):
            return {**row, "wrong": f"{flag}: expected a folder, then flags with a value"}
        row[name] = value if equals else rest.pop(0)
    return row


def _read_parquet(path: Path) -> list[dict[str, Any]]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise DataError("needs pyarrow: pip install 'roadprior[cluster]', or write the list as text") from error
    try:
        rows: list[dict[str, Any]] = parquet.read_table(path).to_pylist()
    except (OSError, ArrowException) as error:
        raise DataError(f"cannot be read as Parquet ({str(error).splitlines()[0]})") from error
    return rows


def _entry(row: Mapping[str, Any], home: Path, usual: DriveEntry) -> DriveEntry:
    """Make an entry of a list's row; DataError where it says what no drive has."""
    said = {name: value for name, value in row.items() if value is not None}
    if "wrong" in said:
        raise DataError(said["wrong"])
    unknown = sorted(said.keys() - {"path", *FLAGS})
    if unknown or not said.get("path"):
        wanted = f"expected path, and of {', '.join(FLAGS)} what is not usual"
        raise DataError(f"{wanted}; found {', '.join(unknown) or 'no path'}")
    part: dict[str, Any] = {name: said[name] for name in OPTIONS if name in said}
    part |= {name: home / str(part[name]) for name in PATHS if name in part}
    if "fx" in part:
        part["fx"] = _number(part["fx"])
    frames = said.get("frames", usual.frames)
    parse_range(frames)
    return DriveEntry(home / said["path"], said.get("dataset", usual.dataset), replace(usual.part, **part), frames)


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise DataError(f"--fx {value}: expected a number, pixels") from error
