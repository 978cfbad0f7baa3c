"""COLMAP's model: cameras, images and points, text or binary, read strictly (COLMAP's docs, "Output format").

    cameras.txt    CAMERA_ID MODEL WIDTH HEIGHT PARAMS...
    images.txt     IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and a line of X Y POINT3D_ID triples, perhaps empty
    points3D.txt   POINT3D_ID X Y Z R G B ERROR and the track
    *.bin          the same, little-endian, with 64-bit counts

Poses are T_cam_world with OpenCV axes. The centre of the top-left pixel is (0.5, 0.5).
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors import codecs
from priors.drives._lens import Lens
from priors.errors import DataError
from priors.geometry import invert
from priors.text import read_text
from priors.types import Matrix

Parsed = TypeVar("Parsed")
Ids = npt.NDArray[np.int64]
MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
"""The models that OpenCV straightens, with their parameters in COLMAP's order."""
NUMBERS = {0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV", 6: "FULL_OPENCV"}
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
NO_POINT = -1
MEND = "export the model again (colmap model_converter)"


@dataclass(frozen=True)
class Shot:
    """An image that COLMAP placed."""

    name: str
    camera: int
    T_world_cam: Matrix
    points: Ids
    """(n,) ids of the points that it sees."""


def find_file(folder: Path, stem: str) -> Path | None:
    """Return a table of the model, the binary one where both are there as COLMAP has it; None without one."""
    return next((path for path in (folder / f"{stem}.bin", folder / f"{stem}.txt") if path.is_file()), None)


def read_lenses(path: Path) -> dict[int, Lens]:
    """Read cameras.txt or cameras.bin: a lens by camera id."""
    return _parse(path, _lenses_of_text if path.suffix == ".txt" else _lenses_of_bytes)


def read_shots(path: Path) -> list[Shot]:
    """Read images.txt or images.bin."""
    return _parse(path, _shots_of_text if path.suffix == ".txt" else _shots_of_bytes)


def read_points(path: Path) -> tuple[Ids, npt.NDArray[np.float64]]:
    """Read points3D.txt or points3D.bin: ids (n,), sorted, and places (n, 3) in the world, in the model's unit."""
    ids, xyz = _parse(path, _points_of_text if path.suffix == ".txt" else _points_of_bytes)
    order = np.argsort(ids)
    return ids[order], xyz[order]


def _parse(path: Path, parse: Callable[[Path], Parsed]) -> Parsed:
    try:
        return parse(path)
    except struct.error as error:
        raise DataError(f"{path}: ends within a record: {MEND}") from error
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: damaged ({error}): {MEND}") from error


def _lines(path: Path) -> list[str]:
    """Return a table's lines without its comments; empty ones are kept."""
    lines = read_text(path, MEND).split("\n")
    return [line.strip() for line in lines if not line.startswith("#")]


def _lens(model: str, size: tuple[int, int], parameters: list[float], camera: object) -> Lens:
    names = MODELS.get(model)
    if names is None:
        raise ValueError(f"camera {camera} is {model}, which is not read: run `colmap image_undistorter` first")
    if len(parameters) != len(names) or not np.isfinite(parameters).all():
        raise ValueError(f"camera {camera}: {model} has {len(names)} parameters, found {parameters}")
    values = dict(zip(names, parameters, strict=True))
    focal = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    if min(focal) <= 0 or min(size) <= 0:
        raise ValueError(f"camera {camera}: focal length {min(focal):g} px, size {size[1]}x{size[0]}")
    distortion = tuple(values.get(name, 0.0) for name in DISTORTION)
    last = max((n for n, value in enumerate(distortion) if value), default=-1)
    count = next(n for n in (0, 4, 5, 8) if last < n)
    return Lens(focal, (values["cx"] - 0.5, values["cy"] - 0.5), size, distortion[:count])


def _shot(q_wxyz: Any, t: Any, camera: int, name: str, points: Ids) -> Shot:
    q = np.array(q_wxyz, np.float64)
    if not np.isfinite([*q, *t]).all() or np.linalg.norm(q) < 1e-6:
        raise ValueError(f"image {name}: its pose is no number")
    T_cam_world = np.eye(4)
    T_cam_world[:3, :3] = Rotation.from_quat([*q[1:], q[0]]).as_matrix()
    T_cam_world[:3, 3] = t
    return Shot(name, camera, invert(T_cam_world), points[points != NO_POINT])


def _lenses_of_text(path: Path) -> dict[int, Lens]:
    lenses = {}
    for line in filter(None, _lines(path)):
        id_, model, width, height, *parameters = line.split()
        lenses[int(id_)] = _lens(model, (int(height), int(width)), list(map(float, parameters)), id_)
    return lenses


def _shots_of_text(path: Path) -> list[Shot]:
    lines = _lines(path)
    while lines and not lines[0]:
        lines.pop(0)
    shots = []
    for heading, seen in zip(lines[::2], [*lines[1::2], ""], strict=False):
        if not heading:
            continue  # behind the last image
        words = heading.split(maxsplit=9)
        if len(words) < 10:
            raise ValueError(f"expected 10 words of an image, found {heading[:60]!r}")
        triples = np.array(seen.split(), dtype=object).reshape(-1, 3)
        points = triples[:, 2].astype(np.int64)
        shots.append(_shot(list(map(float, words[1:5])), list(map(float, words[5:8])), int(words[8]), words[9], points))
    return shots


def _points_of_text(path: Path) -> tuple[Ids, npt.NDArray[np.float64]]:
    rows = [line.split(maxsplit=4)[:4] for line in _lines(path) if line]
    table = np.array([[float(word) for word in row[1:]] for row in rows], np.float64).reshape(-1, 3)
    return np.array([int(row[0]) for row in rows], np.int64), table


class _Bytes:
    """Reads a binary table from its start."""

    def __init__(self, path: Path) -> None:
        self.data, self.at = codecs.read_bytes(path, MEND), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Read the next values; struct.error where the file ends before."""
        found = struct.unpack_from(f"<{layout}", self.data, self.at)
        self.at += struct.calcsize(f"<{layout}")
        return found

    def count(self) -> Iterator[int]:
        """Read how many there are, and count through them."""
        return iter(range(int(self.take("Q")[0])))

    def text(self) -> str:
        """Read a name up to its zero byte."""
        end = self.data.index(b"\0", self.at)
        found, self.at = self.data[self.at : end].decode(), end + 1
        return found

    def skip(self, size: int) -> None:
        """Leave bytes out; ValueError where there are not so many."""
        self.at += size
        if self.at > len(self.data):
            raise ValueError("truncated")


def _lenses_of_bytes(path: Path) -> dict[int, Lens]:
    table, lenses = _Bytes(path), {}
    for _ in table.count():
        id_, number, width, height = table.take("IiQQ")
        model = NUMBERS.get(number, f"model {number}")
        parameters = list(table.take(f"{len(MODELS.get(model, ()))}d"))
        lenses[id_] = _lens(model, (height, width), parameters, id_)
    return lenses


def _shots_of_bytes(path: Path) -> list[Shot]:
    table, shots = _Bytes(path), []
    for _ in table.count():
        _, *pose, camera = table.take("I7dI")
        name, (seen,) = table.text(), table.take("Q")
        layout = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
        start = table.at
        table.skip(seen * layout.itemsize)
        points = np.frombuffer(table.data, layout, seen, start)["point"].astype(np.int64)
        shots.append(_shot(pose[:4], pose[4:], camera, name, points))
    return shots


def _points_of_bytes(path: Path) -> tuple[Ids, npt.NDArray[np.float64]]:
    table = _Bytes(path)
    ids, xyz = [], []
    for _ in table.count():
        id_, x, y, z, *_, track = table.take("Q3d3BdQ")
        table.skip(8 * track)
        ids.append(id_)
        xyz.append((x, y, z))
    return np.array(ids, np.int64), np.array(xyz, np.float64).reshape(-1, 3)
