"""Description of a user's own single-image network: a few lines beside its ONNX file, how to feed and read it.

model.onnx    model.toml (or model.json):

    output = "disparity"              # or "relative-depth", "metric-depth"
    size = [518, 1708]                # height, width it is fed; left out: the image's own, rounded to `multiple`
    multiple = 14                     # default 1
    mean = [0.485, 0.456, 0.406]      # RGB in [0, 1]: (image - mean) / std is fed; default 0 and 1
    std = [0.229, 0.224, 0.225]
    fit = "stretch"                   # or "pad": keeps the aspect, fills below and right with the mean
    focal_px = 1000.0                 # of the camera that metric depth is meant for, at the size fed; left out: the
                                      # network's depth is metric for any camera
    input, output_name                # names in the file; default: the first of each
"""

import json
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from priors.errors import DataError
from priors.text import read_text

OUTPUTS = ("metric-depth", "relative-depth", "disparity")
FITS = ("stretch", "pad")


@dataclass(frozen=True)
class NetworkDescription:
    """How to feed a network and what it answers; the fields are explained above."""

    output: str
    size: tuple[int, int] | None = None
    multiple: int = 1
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    fit: str = "stretch"
    focal_px: float | None = None
    input: str | None = None
    output_name: str | None = None


def describe(weights: Path) -> NetworkDescription:
    """Read the description beside an ONNX file; DataError, one line, where something is missing or wrong."""
    path = description_path(weights)
    entries = _read(path)
    allowed = [field.name for field in fields(NetworkDescription)]
    if unknown := sorted(entries.keys() - set(allowed)):
        raise DataError(f"{path}: unknown key {unknown[0]!r}: expected some of {', '.join(allowed)}")
    if entries.get("output") not in OUTPUTS:
        raise DataError(f"{path}: output is {entries.get('output')!r}, expected one of {', '.join(OUTPUTS)}")
    if entries.get("fit", FITS[0]) not in FITS:
        raise DataError(f"{path}: fit is {entries['fit']!r}, expected {' or '.join(FITS)}")
    for name, count in (("size", 2), ("mean", 3), ("std", 3)):
        if name in entries:
            entries[name] = _numbers(path, name, entries[name], count)
    for name in ("multiple", "focal_px"):
        if name in entries:
            (entries[name],) = _numbers(path, name, [entries[name]], 1)
    if "size" in entries:
        entries["size"] = tuple(int(value) for value in entries["size"])
    if "multiple" in entries:
        entries["multiple"] = int(entries["multiple"])
    return NetworkDescription(**entries)


def description_path(weights: Path) -> Path:
    """Return the file that describes an ONNX file; DataError where there is none."""
    for suffix in (".toml", ".json"):
        if weights.with_suffix(suffix).is_file():
            return weights.with_suffix(suffix)
    if not weights.is_file():
        raise DataError(f"{weights}: no such file")
    raise DataError(
        f'{weights}: say beside it, in {weights.with_suffix(".toml").name}, what it is: output = "disparity", ... '
        "(docs/methods/mono.md)"
    )


def _read(path: Path) -> dict[str, Any]:
    """Read the entries of a description."""
    try:
        text = read_text(path)
        entries = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except ValueError as error:
        raise DataError(f"{path}: cannot be read ({error})") from error
    if not isinstance(entries, dict):
        raise DataError(f"{path}: expected keys and values")
    return entries


def _numbers(path: Path, name: str, value: Any, count: int) -> tuple[float, ...]:
    """Check a list of `count` numbers; all but the mean must be above 0."""
    plain = isinstance(value, list) and len(value) == count
    if not plain or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
        raise DataError(f"{path}: {name} is {value!r}, expected {'a number' if count == 1 else f'{count} numbers'}")
    if name != "mean" and min(value) <= 0:
        raise DataError(f"{path}: {name} is {value!r}, expected above 0")
    return tuple(value)
