"""Point clouds as binary little-endian PLY files: positions, colours, and what else a point has.

Positions are float32 near an origin. Where that is not zero the file holds doubles in the drive's own frame, since
float32 is too coarse there.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from eval.files import replacing
from priors import origin
from priors.origin import Offset

POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
)  # fmt: skip
"""The least that a point has; others have more fields."""
Points: TypeAlias = npt.NDArray[np.void]
COMMENTS = ("metres, in the drive's world frame",)
FIELDS = (
    "x y z: metres, in the drive's world frame",
    "confidence: of the depth map, 0 to 1, 1 where it has none",
    "depth: metres, along the z axis of the camera that sees the point from nearest",
    "views: how many frames see its voxel",
)
"""What the points of fused maps hold: lines for the header."""
_KINDS = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<i4": "int"}
"""Names of what most readers take: open3d knows no unsigned numbers of 16 bits."""


def write_ply(path: Path, points: Points, origin_m: Offset = origin.NONE, comments: Sequence[str] = COMMENTS) -> None:
    """Write points (n,) with fields x, y, z and any others, atomically.

    Args:
        path: the file.
        points: a field is a property of its name; x, y and z are metres from the origin.
        origin_m: what is put back on the positions, in float64; they are doubles then.
        comments: lines for the header: units and frame.
    """
    if origin_m != origin.NONE:
        points = _put_back(points, origin_m)
    names = points.dtype.names or ()
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines += [f"element vertex {len(points)}"]
    lines += [f"property {_KINDS[points.dtype[name].str]} {name}" for name in names] + ["end_header"]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write("".join(f"{line}\n" for line in lines).encode())
        file.write(np.ascontiguousarray(points).data)


def _put_back(points: Points, origin_m: Offset) -> Points:
    """Return points of an origin's frame in the drive's own, x, y and z as doubles."""
    wide = np.dtype([(name, "<f8" if name in "xyz" else points.dtype[name]) for name in points.dtype.names or ()])
    moved = points.astype(wide)
    for name, offset_m in zip("xyz", origin_m, strict=True):
        moved[name] += offset_m
    return moved
