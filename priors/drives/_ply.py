"""PLY point clouds, ascii and binary, read strictly: what Argoverse's sweeps come in."""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.drives._points import only_points
from priors.errors import DataError, unreadable

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4)},
    **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4)},
    **{f"float{8 * size}": f"f{size}" for size in (4, 8)},
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
END = b"end_header"


def read_ply(path: Path) -> npt.NDArray[np.float32]:
    """Read the vertices' x, y, z: (n, 3) metres; values that no scanner measures are left out.

    Raises:
        DataError: not a PLY file, no x y z, truncated, or without a single point.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from error
    try:
        vertices = _parse(data)
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: damaged PLY file ({error}): download it again") from error
    xyz_m = np.stack([vertices[axis].astype(np.float32) for axis in "xyz"], axis=1)
    if not len(xyz_m):
        raise DataError(f"{path}: empty sweep: download it again, or leave the frame out with --frames")
    return xyz_m[only_points(xyz_m, path, "x y z in metres")]


def _parse(data: bytes) -> npt.NDArray[np.void]:
    """Return the vertex element as a structured array; ValueError or KeyError says what is wrong."""
    end = data.find(END)
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header")
    body = data.index(b"\n", end) + 1
    lines = [line.split() for line in data[:end].decode("ascii").splitlines()[1:]]
    format_ = next((words[1] for words in lines if words and words[0] == "format"), "")
    if format_ not in ORDERS:
        raise ValueError(f"format {format_!r}")
    count, dtype = _vertex_layout(lines, ORDERS[format_])
    if format_ == "ascii":
        table = np.loadtxt(io.BytesIO(data[body:]), ndmin=2, max_rows=count, dtype=np.float64) if count else None
        if table is None:
            return np.zeros(0, dtype)
        if table.shape != (count, len(dtype.names or ())):
            raise ValueError(f"{count} vertices announced, {table.shape[0]} rows of {table.shape[1]} found")
        return np.rec.fromarrays(list(table.T), dtype=dtype)
    whole = (len(data) - body) // dtype.itemsize
    if whole < count:
        raise ValueError(f"truncated: {count} vertices announced, {whole} found")
    return np.frombuffer(data, dtype, count, body)


def _vertex_layout(lines: list[list[str]], order: str) -> tuple[int, np.dtype[np.void]]:
    """Read the header's vertex element: how many, and the type of one. It must come first and hold no lists."""
    first = next((n for n, words in enumerate(lines) if words and words[0] == "element"), None)
    if first is None or lines[first][1] != "vertex":
        raise ValueError("the first element is not vertex")
    fields = []
    for words in lines[first + 1 :]:
        if not words or words[0] == "comment":
            continue
        if words[0] != "property":
            break
        fields.append((words[2], order + TYPES[words[1]]))
    missing = {"x", "y", "z"} - {name for name, _ in fields}
    if missing:
        raise ValueError(f"no property {', '.join(sorted(missing))}")
    return int(lines[first][2]), np.dtype(fields)
