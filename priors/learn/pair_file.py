"""Training pairs on disk: one .npz file each, not compressed, for reading must cost nothing beside training.

| name         | content                                             | of                                    |
|--------------|-----------------------------------------------------|---------------------------------------|
| layout       | LAYOUT                                              | all                                   |
| left         | (h, w, 3) or (h, w) uint8                           | all                                   |
| disparity    | (h, w) uint16, 1/256 px as KITTI's; 0 = none        | all                                   |
| sky          | packed bits of (h, w)                               | all                                   |
| right        | as left                                             | pairs                                 |
| source       | text                                                | pairs                                 |
| weight       | (h, w) uint8, 255 = 1                               | pairs, where some weight is not plain |
| matched      | as disparity: the classical matcher's               | labelled pairs                        |
| K            | (3, 3)                                              | rendered pairs                        |
| baseline_m   | metres                                              | rendered pairs                        |
| points_m     | (n, 3) float32                                      | rendered pairs                        |
| beam         | (n,) uint8                                          | rendered pairs                        |

A plain weight is 1 where there is a disparity or the sky, and 0 elsewhere. A file without a right view holds an image
with a disparity map, which warp.py makes pairs of.
"""

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.files import write_atomically
from priors.errors import DataError
from priors.learn.stereo_pair import Sensors, StereoPair
from priors.learn.warp import DisparityImage
from priors.types import Camera, FloatMap, Image, Mask

LAYOUT = 2
"""Raised when files of before cannot be read any more."""
PER_PX = 256
LARGEST = 65535
Arrays = dict[str, npt.NDArray[Any]]


def write(path: Path, pair: StereoPair, matched_px: FloatMap | None = None) -> None:
    """Write a pair, and what the classical matcher found (h, w), px, where it was labelled by that; atomically."""
    arrays = _image(pair.left, pair.disparity_px, pair.sky)
    arrays |= {"right": pair.right, "source": np.array(pair.source)}
    if not np.array_equal(pair.weight, _plain_weight(pair.disparity_px, pair.sky)):
        arrays["weight"] = np.rint(pair.weight * 255).astype(np.uint8)
    if matched_px is not None:
        arrays["matched"] = _fixed_point(matched_px)
    if pair.sensors is not None:
        arrays |= {
            "K": pair.sensors.camera.K,
            "baseline_m": np.array(pair.sensors.baseline_m),
            "points_m": pair.sensors.points_m,
            "beam": pair.sensors.beam,
        }
    _write(path, arrays)


def read(path: Path) -> StereoPair:
    """Read a pair; DataError where the file is damaged or of an older layout."""
    with _opened(path) as arrays:
        left, disparity_px, sky = _read_image(arrays)
        plain = _plain_weight(disparity_px, sky)
        weight = (arrays["weight"] / np.float32(255)).astype(np.float32) if "weight" in arrays else plain
        sensors = None
        if "K" in arrays:
            camera = Camera(arrays["K"], (int(left.shape[0]), int(left.shape[1])))
            sensors = Sensors(camera, float(arrays["baseline_m"]), arrays["points_m"], arrays["beam"])
        return StereoPair(left, arrays["right"], disparity_px, sky, weight, str(arrays["source"]), sensors)


def read_matched(path: Path) -> FloatMap:
    """Read what the classical matcher found of a labelled pair (h, w), px, 0 = none."""
    with _opened(path) as arrays:
        return _pixels(arrays["matched"])


def write_image(path: Path, scene: DisparityImage) -> None:
    """Write an image with its disparity map, atomically."""
    _write(path, _image(scene.image, scene.disparity_px, scene.sky))


def read_disparity_image(path: Path) -> DisparityImage:
    """Read an image with its disparity map."""
    with _opened(path) as arrays:
        return DisparityImage(*_read_image(arrays))


def read_left(path: Path) -> Image:
    """Read the left image only, or the only one."""
    with _opened(path) as arrays:
        return np.asarray(arrays["left"])


def _image(left: Image, disparity_px: FloatMap, sky: Mask) -> Arrays:
    """Return what every file holds."""
    return {
        "layout": np.array(LAYOUT),
        "left": left,
        "disparity": _fixed_point(disparity_px),
        "sky": np.packbits(sky),
    }


def _read_image(arrays: Mapping[str, npt.NDArray[Any]]) -> tuple[Image, FloatMap, Mask]:
    left = arrays["left"]
    height, width = left.shape[:2]
    sky = np.unpackbits(arrays["sky"], count=height * width).reshape(height, width).astype(np.bool_)
    return left, _pixels(arrays["disparity"]), sky


def _fixed_point(map_px: FloatMap) -> npt.NDArray[np.uint16]:
    return np.minimum(np.rint(map_px * PER_PX), LARGEST).astype(np.uint16)


def _pixels(map_: npt.NDArray[np.uint16]) -> FloatMap:
    return (map_ / np.float32(PER_PX)).astype(np.float32)


def _plain_weight(disparity_px: FloatMap, sky: Mask) -> FloatMap:
    return ((disparity_px > 0) | sky).astype(np.float32)


def _write(path: Path, arrays: Arrays) -> None:
    def save(target: Path) -> None:
        with target.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    write_atomically(path, save)


@contextmanager
def _opened(path: Path) -> Iterator[Mapping[str, npt.NDArray[Any]]]:
    """Open a file, whose arrays are read when they are asked for."""
    again = f"delete {path.parent}/ and run the command that made it again"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if "layout" not in arrays or int(arrays["layout"]) != LAYOUT:
                raise DataError(f"{path}: a training pair of an older layout: {again}")
            yield arrays
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: damaged training pair ({error}): {again}") from error
