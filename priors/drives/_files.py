"""What every reader does with files: text to numbers, timestamps, digests. Errors name the file."""

import hashlib
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.errors import DataError


def read_text(path: Path) -> str:
    """Read a small text file; DataError where it is missing or not text."""
    try:
        return path.read_text()
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error})") from error


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
    found = values.get(key)
    if found is None:
        raise DataError(f"{path}: calibration key {key} is missing: download the calibration of this date again")
    if found.size != count or not np.isfinite(found).all():
        raise DataError(f"{path}: {key} should be {count} finite numbers, found {found.size}")
    return found


def read_times(path: Path) -> list[float]:
    """Read 'YYYY-MM-DD hh:mm:ss.nnnnnnnnn' lines as seconds since the first."""
    stamps = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        seconds, _, fraction = line.strip().partition(".")
        try:
            stamps.append(datetime.fromisoformat(seconds).timestamp() + float(f"0.{fraction or 0}"))
        except ValueError as error:
            raise DataError(f"{path}: line {number} is not a time: {line.strip()[:40]!r}") from error
    return [stamp - stamps[0] for stamp in stamps]


def stems(folder: Path, suffixes: Iterable[str]) -> dict[str, Path]:
    """Map file stem (the frame id) to file, for files with one of the suffixes; empty where there is no folder."""
    if not folder.is_dir():
        return {}
    wanted = tuple(suffixes)
    return {p.stem: p for p in sorted(folder.iterdir()) if p.suffix.lower() in wanted and not p.name.startswith(".")}


def digest(files: Iterable[Path]) -> str:
    """Hash the files' content (not names or times): the same drive elsewhere has the same digest."""
    sha = hashlib.sha256()
    for file in files:
        try:
            sha.update(hashlib.sha256(file.read_bytes()).digest())
        except OSError as error:
            raise DataError(f"{file}: cannot be read ({error.strerror})") from error
    return sha.hexdigest()


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
