"""What every reader does with files: text to numbers, folders to ids, digests. Errors name the file."""

import hashlib
import os
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.errors import DataError, UsageError, unreadable
from priors.frame_ids import in_order
from priors.text import read_lines, read_text
from priors.types import Camera, Image, Matrix

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
CALIBRATION = "download the calibration again"


def read_key_values(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Read 'key: numbers' lines (KITTI calibration); lines that hold no numbers are left out."""
    values = {}
    for line in read_lines(path, CALIBRATION):
        key, _, numbers = line.text.partition(":")
        try:
            values[key.strip()] = np.array([float(word) for word in numbers.split()])
        except ValueError:
            continue  # calib_time: 09-Jan-2012 13:57:47
    return values


def need(values: dict[str, npt.NDArray[np.float64]], key: str, count: int, path: Path) -> npt.NDArray[np.float64]:
    """Return values[key], or raise DataError that names file and key where it is missing, short or not finite."""
    numbers = values.get(key)
    if numbers is None:
        raise DataError(f"{path}: calibration key {key} is missing or no numbers: {CALIBRATION}")
    if numbers.size != count or not np.isfinite(numbers).all():
        raise DataError(f"{path}: {key} should be {count} finite numbers, found {numbers.tolist()}: {CALIBRATION}")
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


def read_times(path: Path) -> dict[int, float]:
    """Read 'YYYY-MM-DD hh:mm:ss.nnnnnnnnn' lines as seconds since the first, by line number from 0.

    An empty line stands for a scan that is missing (KITTI's velodyne timestamps have them) and gets no entry.
    """
    stamps = {}
    for number, line in enumerate(read_lines(path)):
        if not line.text:
            continue
        seconds, _, fraction = line.text.partition(".")
        try:
            whole = datetime.fromisoformat(seconds).replace(tzinfo=UTC).timestamp()
            stamps[number] = whole + float(f"0.{fraction or 0}")
        except ValueError as error:
            found = f"line {line.number} is not a time: {line.text[:40]!r}"
            raise DataError(f"{path}: {found}: download it again, or take the file away") from error
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
        raise DataError(f"{folder}: cannot be listed ({error.strerror}): chmod u+rx lets you") from error
    wanted = tuple(suffixes)
    found = {n.rpartition(".")[0]: folder / n for n in sorted(names) if n.lower().endswith(wanted) and n[0] != "."}
    return {id_: found[id_] for id_ in in_order(found)}


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
        UsageError: --drive names none of them, or there is more than one to choose from.
        DataError: there is none; `what` says in words what a drive's folder holds.
    """
    named = [folder for folder in folders if drive is None or folder.name == drive]
    some = ", ".join(folder.name for folder in folders[:5]) + (", ..." if len(folders) > 5 else "")
    if not named and folders:
        raise UsageError(f"{path}: no drive {drive!r} in it: found {some}")
    if not named:
        raise DataError(f"{path}: {what} not found in it")
    if len(named) > 1 and drive is not None:
        raise DataError(f"{path}: holds {len(named)} drives named {drive}: name the folder itself, e.g. {named[0]}")
    if len(named) > 1:
        raise UsageError(f"{path}: holds {len(named)} drives: choose with --drive {named[0].name} (found {some})")
    return named[0]


def digest(files: Iterable[Path]) -> str:
    """Hash the files' content (not names or times): the same drive elsewhere has the same digest."""
    sha = hashlib.sha256()
    for file in files:
        try:
            sha.update(hashlib.sha256(file.read_bytes()).digest())
        except OSError as error:
            raise unreadable(file, error) from error
    return sha.hexdigest()


def revise(fingerprint: str, *reasons: str) -> str:
    """Return another fingerprint, of the same files from which something else was made, for these reasons."""
    return hashlib.sha256("/".join([fingerprint, *reasons]).encode()).hexdigest()


def image_size(path: Path) -> tuple[int, int]:
    """Return (height, width) of an image by its header: a thousand of them take a second, not a minute."""
    from PIL import Image as Pillow

    try:
        with Pillow.open(path) as image:
            width, height = image.size
    except OSError as error:
        raise DataError(f"{path}: damaged image ({error.strerror or 'not an image'}): download it again") from error
    return height, width
