"""A user's own single-image network: an ONNX file, and beside it a few lines that say how to feed and read it.

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
import threading
import tomllib
from dataclasses import dataclass, fields
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.errors import DataError
from priors.types import Camera, FloatMap, Image

OUTPUTS = ("metric-depth", "relative-depth", "disparity")
_RUNNING = threading.Lock()


@dataclass(frozen=True)
class Description:
    """How to feed a network and what it answers."""

    output: str
    size: tuple[int, int] | None = None
    multiple: int = 1
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    fit: str = "stretch"
    focal_px: float | None = None
    input: str | None = None
    output_name: str | None = None


def describe(weights: Path) -> Description:
    """Read the description beside an ONNX file; DataError, one line, where something is missing or wrong."""
    path = description_path(weights)
    try:
        text = path.read_text()
        found = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read ({error})") from error
    if not isinstance(found, dict):
        raise DataError(f"{path}: expected keys and values")
    allowed = [field.name for field in fields(Description)]
    if unknown := sorted(found.keys() - set(allowed)):
        raise DataError(f"{path}: unknown key {unknown[0]!r}: expected some of {', '.join(allowed)}")
    if found.get("output") not in OUTPUTS:
        raise DataError(f"{path}: output is {found.get('output')!r}, expected one of {', '.join(OUTPUTS)}")
    if found.get("fit", "stretch") not in ("stretch", "pad"):
        raise DataError(f"{path}: fit is {found['fit']!r}, expected stretch or pad")
    for name, count in (("size", 2), ("mean", 3), ("std", 3)):
        if name in found:
            found[name] = _numbers(path, name, found[name], count)
    for name in ("multiple", "focal_px"):
        if name in found:
            (found[name],) = _numbers(path, name, [found[name]], 1)
    if "size" in found:
        found["size"] = tuple(int(value) for value in found["size"])
    if "multiple" in found:
        found["multiple"] = int(found["multiple"])
    return Description(**found)


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


def digest(weights: Path) -> str:
    """Hash an ONNX file and its description."""
    description = description_path(weights).read_bytes()
    if not weights.is_file():
        raise DataError(f"{weights}: no such file")
    return sha256(weights.read_bytes() + description).hexdigest()


@dataclass(frozen=True)
class Foreign:
    """A user's network, ready to run."""

    description: Description
    session: Any
    path: Path

    def __call__(self, image: Image, camera: Camera) -> FloatMap:
        """Run it on an image; returns (height, width) in the unit that the description says, 0 = no value.

        Metric depth is brought from the network's focal length to the camera's.
        """
        fed, window = self._feed(image)
        name = self.description.input or self.session.get_inputs()[0].name
        wanted = None if self.description.output_name is None else [self.description.output_name]
        try:
            with _RUNNING:
                found = np.asarray(self.session.run(wanted, {name: fed})[0])
        except Exception as error:  # onnxruntime's errors share no base class but this
            text = str(error).splitlines()[0]
            raise DataError(
                f"{self.path}: cannot run on {fed.shape[3]}x{fed.shape[2]} ({text:.200}): see `size`"
            ) from error
        return self._read(found, window, image.shape[:2], camera)

    def _feed(self, image: Image) -> tuple[npt.NDArray[np.float32], tuple[int, int]]:
        """Return the input (1, 3, h, w), and the part of it (height, width) that the image fills."""
        image = as_rgb(image)
        height, width = image.shape[:2]
        d = self.description
        size = d.size or (-(-height // d.multiple) * d.multiple, -(-width // d.multiple) * d.multiple)
        window = size
        if d.fit == "pad":
            factor = min(size[0] / height, size[1] / width)
            window = max(1, round(height * factor)), max(1, round(width * factor))
        shrinks = window[0] < height
        way = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        small = np.asarray(cv2.resize(image, window[::-1], interpolation=way)).astype(np.float32) / np.float32(255)
        fed = np.zeros((*size, 3), np.float32)
        fed[: window[0], : window[1]] = (small - np.array(d.mean, np.float32)) / np.array(d.std, np.float32)
        return np.ascontiguousarray(fed.transpose(2, 0, 1)[None]), window

    def _read(
        self, found: npt.NDArray[Any], window: tuple[int, int], size: tuple[int, ...], camera: Camera
    ) -> FloatMap:
        plain = found.squeeze()
        if plain.ndim != 2:
            raise DataError(
                f"{self.path}: its output is {found.shape}, expected one map (height, width): see output_name"
            )
        fed = self.description.size or plain.shape
        rows, columns = (max(1, round(n * w / f)) for n, w, f in zip(plain.shape, window, fed, strict=True))
        values = cv2.resize(plain[:rows, :columns].astype(np.float32), size[::-1], interpolation=cv2.INTER_LINEAR)
        if self.description.output == "metric-depth" and self.description.focal_px is not None:
            values = values * np.float32(camera.fx * window[1] / size[1] / self.description.focal_px)
        return np.where(np.isfinite(values) & (values > 0), values, np.float32(0))


def open_foreign(weights: Path) -> Foreign:
    """Open an ONNX file, once a process; DataError where the file or its description is missing or damaged."""
    description = describe(weights)
    return Foreign(description, _session(weights, digest(weights)), weights)


@lru_cache(maxsize=2)
def _session(weights: Path, _digest: str) -> Any:
    import onnxruntime

    try:
        return onnxruntime.InferenceSession(str(weights), providers=onnxruntime.get_available_providers())
    except Exception as error:  # onnxruntime's errors share no base class but this
        raise DataError(f"{weights}: not an ONNX file that onnxruntime can open ({str(error)[:200]})") from error


def _numbers(path: Path, name: str, value: Any, count: int) -> tuple[float, ...]:
    """Check a list of `count` numbers; all but the mean must be above 0."""
    plain = isinstance(value, list) and len(value) == count
    if not plain or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
        raise DataError(f"{path}: {name} is {value!r}, expected {'a number' if count == 1 else f'{count} numbers'}")
    if name != "mean" and min(value) <= 0:
        raise DataError(f"{path}: {name} is {value!r}, expected above 0")
    return tuple(value)
