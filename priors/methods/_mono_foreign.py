"""A user's own single-image network: an ONNX file, run on the frames of a drive (see _mono_description.py)."""

import threading
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.errors import DataError
from priors.methods._mono_description import NetworkDescription, describe, description_path
from priors.types import Camera, FloatMap, Image

_RUNNING = threading.Lock()


def digest(weights: Path) -> str:
    """Hash an ONNX file and its description."""
    description = description_path(weights).read_bytes()
    if not weights.is_file():
        raise DataError(f"{weights}: no such file")
    return sha256(weights.read_bytes() + description).hexdigest()


@dataclass(frozen=True)
class ForeignNetwork:
    """A user's network, ready to run."""

    description: NetworkDescription
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
                answer = np.asarray(self.session.run(wanted, {name: fed})[0])
        except Exception as error:  # onnxruntime's errors share no base class but this
            text = str(error).splitlines()[0]
            raise DataError(
                f"{self.path}: cannot run on {fed.shape[3]}x{fed.shape[2]} ({text:.200}): see `size`"
            ) from error
        return self._read(answer, window, image.shape[:2], camera)

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
        self, answer: npt.NDArray[Any], window: tuple[int, int], size: tuple[int, ...], camera: Camera
    ) -> FloatMap:
        plain = answer.squeeze()
        if plain.ndim != 2:
            raise DataError(
                f"{self.path}: its output is {answer.shape}, expected one map (height, width): see output_name"
            )
        fed = self.description.size or plain.shape
        rows, columns = (max(1, round(n * w / f)) for n, w, f in zip(plain.shape, window, fed, strict=True))
        values = cv2.resize(plain[:rows, :columns].astype(np.float32), size[::-1], interpolation=cv2.INTER_LINEAR)
        if self.description.output == "metric-depth" and self.description.focal_px is not None:
            values = values * np.float32(camera.fx * window[1] / size[1] / self.description.focal_px)
        return np.where(np.isfinite(values) & (values > 0), values, np.float32(0))


def open_foreign(weights: Path) -> ForeignNetwork:
    """Open an ONNX file, once a process; DataError where the file or its description is missing or damaged."""
    description = describe(weights)
    return ForeignNetwork(description, _session(weights, digest(weights)), weights)


@lru_cache(maxsize=2)
def _session(weights: Path, _digest: str) -> Any:
    import onnxruntime

    try:
        return onnxruntime.InferenceSession(str(weights), providers=onnxruntime.get_available_providers())
    except Exception as error:  # onnxruntime's errors share no base class but this
        raise DataError(f"{weights}: not an ONNX file that onnxruntime can open ({str(error)[:200]})") from error
