"""What the tests of exports share: a prior whose maps are a drive's truth, and formats read as a stranger would."""

from pathlib import Path

import numpy as np

from priors import cache
from priors.cache import Prior
from priors.export.views import Views, choose
from priors.filters import Filters
from priors.types import Depth, Drive


def truth_prior(drive: Drive, folder: Path, confident: bool = True) -> Prior:
    """Write the drive's truth as a prior; its confidence falls from 1 in the first column to 0.5 in the last."""
    camera = drive[0].camera
    manifest = {
        "format": 2,
        "drive": {"name": drive.name, **drive.describe()},
        "fingerprint": drive.fingerprint(),
        "camera": {"K": camera.K.tolist(), "size": list(camera.size)},
    }
    prior = cache.load(cache.create(folder / drive.name / "truth-aa", manifest).folder)
    for frame in (drive[index] for index in range(len(drive))):
        depth_m = frame.truth().depth_m
        falling = np.broadcast_to(np.linspace(1, 0.5, depth_m.shape[1], dtype=np.float32), depth_m.shape)
        prior.write(frame.id, Depth(depth_m, np.where(depth_m > 0, falling, 0) if confident else None), 0.1)
    return prior


def views_of(prior: Prior, drive: Drive, frames: str | None = None, filters: Filters | None = None) -> Views:
    return choose(prior, drive, frames, filters or Filters(), posed=True)


def read_ply(path: Path) -> tuple[np.ndarray, list[str]]:
    """Read a PLY file by its header: the vertices, and the comments."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    points = np.frombuffer(body, np.dtype([(name, kinds[kind]) for kind, name in fields]))
    assert len(points) == count
    return points, [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]


def rotation_of(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Turn a unit quaternion into a rotation by the textbook's formula."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


class Model:
    """A COLMAP text model, read line by line."""

    def __init__(self, folder: Path) -> None:
        self.cameras = {int(w[0]): w[1:] for w in self._words(folder / "cameras.txt")}
        lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
        self.images, self.seen = {}, {}
        for first, second in zip(lines[::2], lines[1::2], strict=True):
            words = first.split()
            self.images[words[9]] = (np.array(words[1:8], float), int(words[8]), int(words[0]))
            self.seen[int(words[0])] = np.array(second.split(), float).reshape(-1, 3)
        self.points = {int(w[0]): (np.array(w[1:4], float), list(map(int, w[4:7])), float(w[7]), np.array(w[8:], int))
                       for w in self._words(folder / "points3D.txt")}  # fmt: skip

    def T_world_cam(self, name: str) -> np.ndarray:
        """A pose (4, 4), camera to world."""
        numbers = self.images[name][0]
        T = np.eye(4)
        T[:3, :3] = rotation_of(*numbers[:4]).T
        T[:3, 3] = -T[:3, :3] @ numbers[4:]
        return T

    def K(self, name: str) -> np.ndarray:
        """A camera's matrix, pixels, the centre of the top-left pixel at (0.5, 0.5), and its size."""
        model, _, _, *numbers = self.cameras[self.images[name][1]]
        assert model == "PINHOLE"
        fx, fy, cx, cy = map(float, numbers)
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def _words(self, path: Path) -> list[list[str]]:
        return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
