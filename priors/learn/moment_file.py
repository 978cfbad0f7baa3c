"""Moments on disk: one .npz file each, its parts compressed as far as training does not notice.

| name                 | content                                                                                 |
|----------------------|-----------------------------------------------------------------------------------------|
| layout, source, name | LAYOUT, text                                                                            |
| left, right          | WebP of quality QUALITY (about 36 dB)                                                   |
| true, matched        | disparities in 1/32 and 1/8 px: which pixels, then the values' steps, by LZMA            |
| rows                 | (h, w) and the matched weight: float64                                                  |
| sky                  | packed bits, by LZMA                                                                    |
| K, baseline_m, error | the camera; RectificationError's five numbers                                           |
| points, beam, T      | columns and rows in 1/16 px and depths in 1/256 m, by scan line; the LiDAR's place       |
| sweeps<n>            | what n sweeps make, metres in 1/256, as `true`                                          |

Of the match every second row and column is kept. So a disparity is off by 1/64 px at most, a point by 1/32 px.
"""

import lzma
import zipfile
from dataclasses import astuple
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from eval.files import write_atomically
from priors.errors import DataError
from priors.learn.moment import Moment, Scan
from priors.pairs.rectification import RectificationError
from priors.types import Camera, FloatMap, Image

LAYOUT = 1
QUALITY = 85
"""Of WebP."""
TRUE_PER_PX, MATCHED_PER_PX, POINT_PER_PX, PER_M = 32, 8, 16, 256
MATCHED_EVERY = 2
"""Rows and columns of the match that are kept."""
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]
SWEEPS = "sweeps"
Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int32]


def write(path: Path, moment: Moment) -> None:
    """Write a moment, atomically."""
    thin_px = np.zeros_like(moment.matched_px)
    every = slice(None, None, MATCHED_EVERY)
    thin_px[every, every] = moment.matched_px[every, every]
    arrays: dict[str, Any] = {
        "layout": LAYOUT,
        "source": moment.source,
        "name": moment.name,
        "left": _encode(moment.left),
        "true": _squeeze_map(moment.true_px, TRUE_PER_PX),
        "matched": _squeeze_map(thin_px, MATCHED_PER_PX),
        "rows": np.array([*moment.left.shape[:2], moment.matched_weight], np.float64),
        "sky": _squeeze(np.packbits(moment.sky).tobytes()),
        "K": moment.camera.K,
        "baseline_m": moment.baseline_m,
        "error": np.array(astuple(moment.error)),
    }
    if moment.right is not None:
        arrays["right"] = _encode(moment.right)
    if moment.scan is not None:
        arrays |= _scan_arrays(moment.scan, moment.camera)

    def save(target: Path) -> None:
        with target.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: np.asarray(value) for name, value in arrays.items()})

    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, save)


def read(path: Path) -> Moment:
    """Read a moment; DataError where the file is damaged or of another layout."""
    again = f"delete {path} and run priors train pack-crops again"
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if int(arrays["layout"]) != LAYOUT:
            raise DataError(f"{path}: a crop of layout {arrays['layout']}, expected {LAYOUT}: {again}")
        return _moment(arrays)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, lzma.LZMAError) as error:
        raise DataError(f"{path}: damaged crop ({error}): {again}") from error


def _moment(arrays: dict[str, npt.NDArray[Any]]) -> Moment:
    height, width, weight = arrays["rows"].tolist()
    size = int(height), int(width)
    camera = Camera(arrays["K"], size)
    sky = np.unpackbits(np.frombuffer(_expand(arrays["sky"]), np.uint8), count=size[0] * size[1])
    return Moment(
        str(arrays["source"]),
        str(arrays["name"]),
        _decode(arrays["left"]),
        _decode(arrays["right"]) if "right" in arrays else None,
        camera,
        float(arrays["baseline_m"]),
        _expand_map(arrays["true"], size, TRUE_PER_PX),
        _expand_map(arrays["matched"], size, MATCHED_PER_PX),
        weight,
        sky.reshape(size).astype(np.bool_),
        RectificationError(*arrays["error"].tolist()),
        _scan(arrays, camera) if "points" in arrays else None,
    )


def _scan_arrays(scan: Scan, camera: Camera) -> dict[str, npt.NDArray[Any]]:
    """Return a scan's points along its lines, as places in the image and depths."""
    z = scan.points_m[:, 2].astype(np.float64)
    uv = scan.points_m[:, :2] / z[:, None] * [camera.K[0, 0], camera.K[1, 1]] + camera.K[:2, 2]
    order = np.lexsort((uv[:, 0], scan.beam))
    values = np.rint(np.column_stack([uv * POINT_PER_PX, z * PER_M])[order]).astype(np.int32)
    arrays: dict[str, npt.NDArray[Any]] = {
        "points": _squeeze_steps(values.T.ravel()),
        "beam": _squeeze(scan.beam[order].tobytes()),
        "T": scan.T_cam_lidar,
    }
    return arrays | {f"{SWEEPS}{count}": _squeeze_map(map_, PER_M) for count, map_ in scan.accumulated_m.items()}


def _scan(arrays: dict[str, npt.NDArray[Any]], camera: Camera) -> Scan:
    values = _expand_steps(arrays["points"]).reshape(3, -1).T.astype(np.float64)
    z = np.maximum(values[:, 2:], 1) / PER_M
    xy = (values[:, :2] / POINT_PER_PX - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]] * z
    beam = np.frombuffer(_expand(arrays["beam"]), np.uint8)
    maps = {name.removeprefix(SWEEPS): map_ for name, map_ in arrays.items() if name.startswith(SWEEPS)}
    accumulated_m = {int(count): _expand_map(map_, camera.size, PER_M) for count, map_ in maps.items()}
    return Scan(np.concatenate([xy, z], axis=1).astype(np.float32), beam, arrays["T"], accumulated_m)


def _encode(image: Image) -> Bytes:
    bgr = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return np.asarray(cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])[1], np.uint8)


def _decode(data: Bytes) -> Image:
    """Decode a view; a grey one comes back with three equal channels, for WebP knows colours only."""
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError("an image that cannot be decoded")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def _squeeze_map(map_: FloatMap, per_unit: int) -> Bytes:
    """Compress a map (h, w), 0 = none: one bit a pixel, then the values' steps along the rows."""
    codes = np.rint(map_ * per_unit).astype(np.int32)
    known = _squeeze(np.packbits(codes > 0).tobytes())
    head = np.array([len(known)], np.int64).view(np.uint8)
    return np.concatenate([head, known, _squeeze_steps(codes[codes > 0])])


def _expand_map(data: Bytes, size: tuple[int, int], per_unit: int) -> FloatMap:
    split = 8 + int(data[:8].view(np.int64)[0])
    bits = np.frombuffer(_expand(data[8:split]), np.uint8)
    known = np.unpackbits(bits, count=size[0] * size[1]).astype(np.bool_)
    codes = np.zeros(size[0] * size[1], np.float32)
    codes[known] = _expand_steps(data[split:])
    return codes.reshape(size) / np.float32(per_unit)


def _squeeze_steps(values: Ints) -> Bytes:
    """Compress integers (n,) by their differences, byte planes apart: the high ones are nearly empty."""
    steps = np.diff(values, prepend=np.int32(0)).astype(np.int32)
    return _squeeze(steps.view(np.uint8).reshape(-1, 4).T.tobytes())


def _expand_steps(data: Bytes) -> Ints:
    planes = np.frombuffer(_expand(data), np.uint8).reshape(4, -1)
    return np.cumsum(np.ascontiguousarray(planes.T).view(np.int32)[:, 0], dtype=np.int32)


def _squeeze(data: bytes) -> Bytes:
    return np.frombuffer(lzma.compress(data, lzma.FORMAT_RAW, filters=FILTERS), np.uint8)


def _expand(data: Bytes) -> bytes:
    return lzma.decompress(data.tobytes(), lzma.FORMAT_RAW, filters=FILTERS)
