"""Image, depth and disparity files, read and written strictly: nothing wraps, nothing is guessed.

| name  | file                                     | no value        | largest value |
|-------|------------------------------------------|-----------------|---------------|
| kitti | uint16 PNG, round(metres or px * 256)    | 0               | 255.99        |
| mm    | uint16 PNG, round(metres * 1000)         | 0               | 65.535 m      |
| npy   | float32                                  | 0, NaN or inf   | -             |
| npz   | float32, one array                       | 0, NaN or inf   | -             |
| pfm   | float32, rows bottom-up                  | 0, NaN or inf   | -             |
"""

import io
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from priors.errors import DataError, unreadable
from priors.types import FloatMap, Image

PNG_SCALE = {"kitti": 256.0, "mm": 1000.0}
FARTHEST_M = 250.0
"""The farthest that methods answer: what a kitti depth PNG holds, less a little."""
LARGEST_CODE = 65535
LOSSLESS = 101
"""OpenCV's WebP quality that keeps every bit."""
_JPEG_MARK = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")
"""A mark; within a scan, 0 after 0xff stands for the value itself, and 0xd0 to 0xd7 begin the data anew."""
_JPEG_END, _JPEG_BARE = 0xD9, (0x01, 0xD8)
"""The end, and marks without a segment."""


def read_image(path: Path) -> Image:
    """Read an 8-bit image: (height, width, 3) RGB, or (height, width) where the file is grey."""
    image = _decode(read_bytes(path), path)
    if image.dtype != np.uint8:
        raise DataError(f"{path}: expected an 8-bit image, found {image.dtype}: convert it")
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[..., :3]
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])


def write_image(path: Path, image: Image, quality: int = 95) -> None:
    """Write an 8-bit RGB or grey image; the suffix (.png, .jpg) names the format."""
    write_bytes(path, encode_image(path, image, quality))


def encode_image(path: Path, image: Image, quality: int = 95) -> bytes:
    """Return the bytes of an image's file; path's suffix names the format, and errors name the path."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if path.suffix.lower() in (".jpg", ".jpeg") else []
    pixels = image if image.ndim == 2 else image[..., ::-1]
    return _encode(path, pixels, options)


def encode_lossless(image: Image) -> bytes:
    """Return an RGB image as a WebP file that keeps every bit: a third of a PNG, for maps of few colours."""
    return _encode(Path("a.webp"), np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_WEBP_QUALITY, LOSSLESS])


def read_depth_png(path: Path, encoding: str = "kitti") -> FloatMap:
    """Read a uint16 depth (metres) or disparity (px) PNG: float32 (height, width), 0 = no value."""
    return decode_depth_png(read_bytes(path), path, encoding)


def decode_depth_png(data: bytes, path: Path, encoding: str = "kitti") -> FloatMap:
    """Read what a file holds as `read_depth_png` does; errors name the path."""
    codes = _decode_codes(data, path, f"write uint16, metres x {PNG_SCALE[encoding]:.0f}")
    return codes.astype(np.float32) / np.float32(PNG_SCALE[encoding])


def _decode_codes(data: bytes, path: Path, advice: str) -> npt.NDArray[np.uint16]:
    """Return the codes of a 16-bit one-channel PNG; `advice` says what to do with one of one channel and other bits."""
    codes = _decode(data, path)
    if codes.dtype != np.uint16 or codes.ndim != 2:
        channels = 1 if codes.ndim == 2 else codes.shape[2]
        kind = f"{8 * codes.itemsize} bits and {channels} channel{'s' if channels > 1 else ''}"
        advice = advice if channels == 1 else "is this a colour map?"
        raise DataError(f"{path}: expected a 16-bit one-channel PNG, found {kind}: {advice}")
    return np.asarray(codes, np.uint16)


def encode_depth(depth_m: npt.NDArray[np.floating], encoding: str = "kitti") -> tuple[npt.NDArray[np.uint16], int]:
    """Turn metres into uint16 codes, rounding to the nearest.

    Values that are not finite or not above 0 become 0 (no value). Values the encoding cannot hold become 0 too,
    never a wrapped or saturated number.

    Returns:
        codes (height, width) and how many values were too large.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        codes = np.rint(depth_m.astype(np.float64) * PNG_SCALE[encoding])
        usable = np.isfinite(depth_m) & (codes > 0)
    too_large = usable & (codes > LARGEST_CODE)
    usable &= ~too_large
    return np.where(usable, codes, 0).astype(np.uint16), int(np.count_nonzero(too_large))


def write_depth_png(path: Path, depth_m: npt.NDArray[np.floating], encoding: str = "kitti") -> int:
    """Write a uint16 depth PNG atomically; returns how many values were too large and left out."""
    data, too_large = encode_depth_png(depth_m, encoding)
    write_bytes(path, data)
    return too_large


def encode_depth_png(depth_m: npt.NDArray[np.floating], encoding: str = "kitti") -> tuple[bytes, int]:
    """Return the bytes of a depth PNG, and how many values were too large and left out."""
    codes, too_large = encode_depth(depth_m, encoding)
    return _encode_png(codes), too_large


def read_confidence_png(path: Path) -> FloatMap:
    """Read a uint16 or uint8 confidence PNG: float32 (height, width) in [0, 1]."""
    return decode_confidence_png(read_bytes(path), path)


def decode_confidence_png(data: bytes, path: Path) -> FloatMap:
    """Read what a file holds as `read_confidence_png` does; errors name the path."""
    codes = _decode(data, path)
    if codes.dtype not in (np.uint8, np.uint16) or codes.ndim != 2:
        raise DataError(f"{path}: expected a one-channel PNG of integers, found {codes.dtype} with shape {codes.shape}")
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)


def write_confidence_png(path: Path, confidence: FloatMap) -> None:
    """Write confidence in [0, 1] as a uint16 PNG, rounded, atomically."""
    write_bytes(path, encode_confidence_png(confidence))


def encode_confidence_png(confidence: FloatMap) -> bytes:
    """Return the bytes of a uint16 PNG of a confidence in [0, 1], rounded.

    Eight bits would lump together most of what a good method trusts: 0.99 and 0.999 are apart by three codes.
    """
    whole = np.nan_to_num(confidence.astype(np.float32, copy=False))  # float16 does not hold 65535
    return _encode_png(np.rint(np.clip(whole, 0, 1) * LARGEST_CODE).astype(np.uint16))


def write_codes_png(path: Path, codes: npt.NDArray[np.uint16]) -> None:
    """Write codes (height, width) as a uint16 PNG, atomically."""
    write_bytes(path, _encode_png(codes))


def read_float_map(path: Path) -> FloatMap:
    """Read depth (metres) or disparity (px) by suffix: .png (kitti), .npy, .npz or .pfm; 0 = no value."""
    return read_depth_png(path) if path.suffix.lower() == ".png" else read_numbers(path)


def read_numbers(path: Path) -> FloatMap:
    """Read a map's numbers as the file holds them, a PNG's codes too; by suffix, 0 = no value."""
    suffix = path.suffix.lower()
    if suffix == ".png":
        values: npt.NDArray[Any] = _decode_codes(read_bytes(path), path, "8 bits are too few for depth: write uint16")
    elif suffix == ".pfm":
        values = read_pfm(path)
    elif suffix in (".npy", ".npz"):
        values = _load_numpy(path)
    else:
        raise DataError(f"{path}: expected .png, .npy, .npz or .pfm, found {suffix or 'no suffix'}")
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(0)).astype(np.float32)


def read_pfm(path: Path) -> FloatMap:
    """Read a one-channel PFM file as stored, top row first; invalid values are the caller's to judge."""
    data = read_bytes(path)
    lines = data.split(b"\n", 3)
    try:
        if lines[0].strip() != b"Pf":
            raise ValueError
        width, height = (int(word) for word in lines[1].split())
        kind = "<f4" if float(lines[2]) < 0 else ">f4"  # the scale's sign is the byte order
        rows = np.frombuffer(lines[3], dtype=kind, count=width * height).reshape(height, width)
    except (ValueError, IndexError) as error:
        raise DataError(f"{path}: expected a one-channel PFM file ('Pf'), found damaged or other data") from error
    return np.ascontiguousarray(rows[::-1]).astype(np.float32)


def write_pfm(path: Path, values: FloatMap) -> None:
    """Write a one-channel little-endian PFM file atomically."""
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode()
    write_bytes(path, header + np.ascontiguousarray(values[::-1]).astype("<f4").tobytes())


def _load_numpy(path: Path) -> npt.NDArray[np.floating]:
    data = io.BytesIO(read_bytes(path))
    try:
        loaded = np.load(data, allow_pickle=False)
        array = loaded if isinstance(loaded, np.ndarray) else loaded[loaded.files[0]]
    except (OSError, ValueError, EOFError, IndexError, zipfile.BadZipFile, zlib.error) as error:
        raise DataError(f"{path}: cannot be read ({error}): write it again with numpy.save") from error
    if array.ndim > 2:
        array = array.squeeze()
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise DataError(f"{path}: expected (height, width) numbers, found {array.dtype} with shape {array.shape}")
    with np.errstate(over="ignore"):
        return np.asarray(array, dtype=np.float32)


def read_bytes(path: Path, lost: str = "") -> bytes:
    """Read a file; DataError where it is missing, which `lost` mends, or cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise unreadable(path, error, lost) from error


def _decode(data: bytes, path: Path) -> npt.NDArray[Any]:
    # OpenCV 4 fills what a truncated file lacks with zeros or grey, which would pass for "no value" or for a wall.
    # What follows the end mark is nobody's: cameras and downloads append it, decoders stop at the mark.
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data and _is_whole(data) else None
    if image is None:
        raise DataError(f"{path}: damaged image ({len(data)} bytes): download or build it again")
    return image


def _is_whole(data: bytes) -> bool:
    """Tell whether a PNG or JPEG has its end mark, whatever follows; other formats are the decoder's to judge."""
    if data.startswith(b"\x89PNG"):
        return _png_ends(data)
    return not data.startswith(b"\xff\xd8") or _jpeg_ends(data)


def _png_ends(data: bytes) -> bool:
    """Walk a PNG's chunks (length, name, content, checksum) to IEND."""
    at = 8
    while at + 12 <= len(data):
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return False


def _jpeg_ends(data: bytes) -> bool:
    """Walk a JPEG's segments and scans to its end mark; the mark of a preview inside a segment is not its own."""
    at = 2
    while mark := _JPEG_MARK.search(data, at):
        code, at = data[mark.end() - 1], mark.end()
        if code == _JPEG_END:
            return True
        if code not in _JPEG_BARE:
            at += int.from_bytes(data[at : at + 2], "big")
    return False


def _encode(path: Path, pixels: npt.NDArray[Any], options: list[int]) -> bytes:
    done, data = cv2.imencode(path.suffix, pixels, options)
    if not done:
        raise DataError(f"{path}: OpenCV cannot write {pixels.dtype} {pixels.shape} as {path.suffix}")
    return data.tobytes()


def _encode_png(codes: npt.NDArray[np.uint16]) -> bytes:
    """Return the bytes of a PNG. Level 1: 31 ms a KITTI frame; level 6 takes four times that to save 3 %."""
    return _encode(Path("codes.png"), codes, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def as_grey(image: Image) -> Image:
    """Return the image as (height, width), by the luma of ITU-R BT.601."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.uint8, copy=False)


def as_rgb(image: Image) -> Image:
    """Return the image as (height, width, 3)."""
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
