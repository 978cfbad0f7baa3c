"""What every reader does with files: text to numbers, folders to ids, digests. Errors name the file."""

import codecs as codecs_of_text
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.errors import DataError
from priors.selection import in_order
from priors.types import Camera, Image, Matrix

Kind = TypeVar("Kind")

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_text(path: Path) -> str:
    """Read a small text file; DataError where it is missing or not text.

    Editors on Windows put a byte order mark first, or write UTF-16. A byte that is no UTF-8 (an umlaut in a comment)
    is read as Latin-1: names and numbers are ASCII and the same in both.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read as text ({error.strerror})") from error
    wide = data.startswith((codecs_of_text.BOM_UTF16_LE, codecs_of_text.BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    raise DataError(f"{path}: is not text: write it again as plain UTF-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; DataError where it is missing, damaged or not an object."""
    try:
        data = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise DataError(f"{path}: damaged JSON ({error}): download or write it again") from error
    if not isinstance(data, dict):
        raise DataError(f"{path}: expected a JSON object, found {type(data).__name__}")
    return data


def read_key_values(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Read 'key: numbers' lines (KITTI calibration); lines that hold no numbers are left out."""
    values = {}
    for line in read_text(path).splitlines():
        key, _, numbers = line.partition(":")
        try:
            values[key.strip()] = np.array([float(word) for word in numbers.split()])
        except ValueError:
            continue  # calib_time: 09-Jan-2012 13:57:47
    return values


def need(values: dict[str, npt.NDArray[np.float64]], key: str, count: int, path: Path) -> npt.NDArray[np.float64]:
    """Return values[key], or raise DataError that names file and key where it is missing, short or not finite."""
    numbers = values.get(key)
    if numbers is None:
        raise DataError(f"{path}: calibration key {key} is missing or no numbers: download the calibration again")
    if numbers.size != count or not np.isfinite(numbers).all():
        raise DataError(f"{path}: {key} should be {count} finite numbers, found {numbers.tolist()}")
    return numbers


def split_projection(P: Matrix, key: str, path: Path) -> tuple[Matrix, Matrix]:
    """Split a rectified projection (3, 4) into K (3, 3) and T_cam_cam0 (4, 4), a shift in metres."""
    K = P[:, :3].copy()
    if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], (0, 0, 1)):
        raise DataError(f"{path}: {key} is no pinhole projection (fx {K[0, 0]:g}, fy {K[1, 1]:g}): download it again")
    T_cam_cam0 = np.eye(4)
    T_cam_cam0[:3, 3] = np.linalg.solve(K, P[:, 3])
    return K, T_cam_cam0


def check_baseline(baseline_m: float, what: str, path: Path) -> float:
    """Return the baseline, or raise DataError where it is not above zero (swapped or equal cameras)."""
    if not baseline_m > 0:
        raise DataError(
            f"{path}: the baseline {what} is {baseline_m:.3f} m, expected > 0: are the two cameras swapped?"
        )
    return baseline_m


def check_size(array: npt.NDArray[Any], path: Path, camera: Camera) -> Any:
    """Return the array, or raise DataError where its size is not the calibration's."""
    if array.shape[:2] != camera.size:
        actual, wanted = (f"{width}x{height}" for height, width in (array.shape[:2], camera.size))
        raise DataError(f"{path}: is {actual}, the calibration is for {wanted}: was one of them resized?")
    return array


def read_sized(path: Path, camera: Camera) -> Image:
    """Read an image that must have the calibration's size."""
    image: Image = check_size(codecs.read_image(path), path, camera)
    return image


def first_size(images: Iterable[Path]) -> tuple[int, int]:
    """Return (height, width) of the first image that can be read: one damaged file must not close a drive."""
    failure: DataError | None = None
    for path in images:
        try:
            height, width = codecs.read_image(path).shape[:2]
            return height, width
        except DataError as error:
            failure = failure or error
    raise failure or DataError("no images")


def parse_pose(line: str, where: str) -> Matrix:
    """Turn 12 numbers, a row-major (3, 4), into a pose (4, 4); `where` names file and line in the error."""
    try:
        numbers = np.array([float(word) for word in line.split()])
    except ValueError as error:
        raise DataError(f"{where}: not 12 numbers: {line.strip()[:40]!r}") from error
    if numbers.size != 12 or not np.isfinite(numbers).all():
        wrong = f"{numbers.size} numbers" if numbers.size != 12 else "NaN or inf"
        raise DataError(f"{where}: a pose should be 12 finite numbers, found {wrong}: repair it or leave the frame out")
    T = np.eye(4)
    T[:3] = numbers.reshape(3, 4)
    return T


def read_times(path: Path) -> dict[int, float]:
    """Read 'YYYY-MM-DD hh:mm:ss.nnnnnnnnn' lines as seconds since the first, by line number from 0.

    An empty line stands for a scan that is missing (KITTI's velodyne timestamps have them) and gets no entry.
    """
    stamps = {}
    for number, line in enumerate(read_text(path).splitlines()):
        if not line.strip():
            continue
        seconds, _, fraction = line.strip().partition(".")
        try:
            whole = datetime.fromisoformat(seconds).replace(tzinfo=UTC).timestamp()
            stamps[number] = whole + float(f"0.{fraction or 0}")
        except ValueError as error:
            raise DataError(f"{path}: line {number + 1} is not a time: {line.strip()[:40]!r}") from error
    start = next(iter(stamps.values()), 0.0)
    return {number: stamp - start for number, stamp in stamps.items()}


def stems(folder: Path, suffixes: Iterable[str]) -> dict[str, Path]:
    """Map file stem (the frame id) to file, for files with one of the suffixes; empty where there is no folder."""
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise DataError(f"{folder}: cannot be listed ({error.strerror})") from error
    wanted = tuple(suffixes)
    found = {n.rpartition(".")[0]: folder / n for n in sorted(names) if n.lower().endswith(wanted) and n[0] != "."}
    return {id_: found[id_] for id_ in in_order(found)}


def joined(ids: Iterable[str], paths: Mapping[str, Kind]) -> dict[str, Kind]:
    """Return files by the frame ids that they belong to: by equal stems, and 7 with 000007 where both are numbers.

    A number that several files have is joined by equal stems only. Files of no frame keep their own stem.
    """
    numbers = Counter(int(stem) for stem in paths if stem.isdecimal())
    by_number = {int(id_): id_ for id_ in ids if id_.isdecimal()}
    own = set(ids)
    named = {}
    for stem, path in paths.items():
        number = int(stem) if stem.isdecimal() else -1
        alike = stem not in own and numbers[number] == 1
        named[by_number.get(number, stem) if alike else stem] = path
    return named


def beside(folder: Path, name: str, up: int = 0) -> Path:
    """Return the file `name` beside a folder, or `up` levels higher: as the folder is named, else as links lead."""
    places = [list(one.parents)[up] / name for one in (folder.absolute(), folder.resolve()) if len(one.parents) > up]
    return next((place for place in places if place.exists()), places[0])


def follow(path: Path) -> Path:
    """Return the folder that path means: itself, or where a link points that a copy turned into a small text file.

    Archives and version control without symbolic links leave the link's target as the file's text.
    """
    if path.is_file() and path.stat().st_size < 1024:
        target = path.parent / read_text(path).strip()
        if target.is_dir():
            return target
    return path


def subfolders(path: Path) -> list[Path]:
    """List the folders directly in path, sorted; files cost no stat call, so huge folders are cheap."""
    try:
        with os.scandir(path) as entries:
            return sorted(path / e.name for e in entries if not e.name.startswith(".") and e.is_dir())
    except OSError:
        return []


def search(path: Path, wanted: Callable[[Path], bool], depth: int) -> list[Path]:
    """List the wanted folders: path itself, or else those one level below, and so on down to depth levels.

    Stops where a level holds more than 10000 folders: recognising a data set must not walk a whole disk.
    """
    level = [path]
    for _ in range(depth + 1):
        matches = [folder for folder in level if wanted(folder)]
        if matches or len(level) > 10_000:
            return matches
        level = [below for folder in level for below in subfolders(folder)]
    return []


def choose(folders: list[Path], drive: str | None, path: Path, what: str) -> Path:
    """Return the only drive among the folders that `path` holds, or the one that --drive names.

    Raises:
        DataError: there is none, or more than one; `what` says in words what a drive's folder holds.
    """
    named = [folder for folder in folders if drive is None or folder.name == drive]
    some = ", ".join(folder.name for folder in folders[:5]) + (", ..." if len(folders) > 5 else "")
    if not named and folders:
        raise DataError(f"{path}: no drive {drive!r} in it: found {some}")
    if not named:
        raise DataError(f"{path}: {what} not found in it")
    if len(named) > 1 and drive is not None:
        raise DataError(f"{path}: holds {len(named)} drives named {drive}: name the folder itself, e.g. {named[0]}")
    if len(named) > 1:
        raise DataError(f"{path}: holds {len(named)} drives: choose with --drive {named[0].name} (found {some})")
    return named[0]


def digest(files: Iterable[Path]) -> str:
    """Hash the files' content (not names or times): the same drive elsewhere has the same digest."""
    sha = hashlib.sha256()
    for file in files:
        try:
            sha.update(hashlib.sha256(file.read_bytes()).digest())
        except OSError as error:
            raise DataError(f"{file}: cannot be read ({error.strerror})") from error
    return sha.hexdigest()
