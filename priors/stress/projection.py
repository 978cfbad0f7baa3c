"""Rows of the table: points and pixels, the three kinds of depth, rigid motions."""

from typing import Any

import numpy as np

from priors import geometry
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import NO_BFLOAT, NO_POSES, Case, Outputs, Routine, without
from priors.types import Camera

SIZE = (12, 20)
FX, BASELINE_M = 180.0, 0.54
COUNT = 200


def project(given: Given) -> Case:
    """Project points; behind the camera and at depth 0 pixels are not finite or mirrored."""
    size = given.size(COUNT)
    xyz_m = np.stack([*given.plain(0.1, 20, (2, *size), signed=True), given.values(1, 80, size)], axis=1)
    ours, camera = given.precision.array(xyz_m), camera_of(SIZE)
    K = camera.K

    def found() -> Outputs:
        uv_px, depth_m = geometry.project(camera, ours)
        return {"u": uv_px[:, 0], "v": uv_px[:, 1], "depth": depth_m}

    def wanted() -> Outputs:
        x, y, z = xyz_m.T
        return {"u": K[0, 0] * x / z + K[0, 2], "v": K[1, 1] * y / z + K[1, 2], "depth": z}

    with np.errstate(all="ignore"):
        shifts = {name: abs(given_px) + abs(at) for name, given_px, at in _parts(K, xyz_m)}
    return Case(found, wanted, scale=shifts)


def _parts(K: Any, xyz_m: Floats) -> list[tuple[str, Floats, float]]:
    x, y, z = xyz_m.T
    return [("u", K[0, 0] * x / z, float(K[0, 2])), ("v", K[1, 1] * y / z, float(K[1, 2]))]


def there_and_back(given: Given) -> Case:
    """Unproject a map and project its points: the pixels and the depths that it had."""
    size = given.size(*SIZE)
    depth_m, camera = given.values(1, 80, size), camera_of(size)
    ours = given.precision.array(depth_m)

    def found() -> Outputs:
        uv_px, back_m = geometry.project(camera, geometry.unproject(camera, ours))
        return {"u": uv_px[:, 0], "v": uv_px[:, 1], "depth": back_m}

    def wanted() -> Outputs:
        rows, columns = np.nonzero(depth_m > 0)
        finite = np.isfinite(depth_m[rows, columns])
        u, v = (np.where(finite, at, np.nan) for at in (columns, rows))
        return {"u": u, "v": v, "depth": depth_m[rows, columns]}

    return Case(found, wanted, scale={"u": float(sum(size)), "v": float(sum(size))})


def range_and_depth(given: Given) -> Case:
    """Turn depth into range and range into depth."""
    size = given.size(*SIZE)
    values, camera = given.values(1, 80, size), camera_of(size)
    ours = given.precision.array(values)

    def found() -> Outputs:
        return {
            "range": geometry.range_from_depth(camera, ours),
            "depth": geometry.depth_from_range(camera, ours),
        }

    def wanted() -> Outputs:
        rows, columns = np.indices(size)
        K = camera.K
        length = np.sqrt(1 + ((columns - K[0, 2]) / K[0, 0]) ** 2 + ((rows - K[1, 2]) / K[1, 1]) ** 2)
        return {"range": values * length, "depth": values / length}

    return Case(found, wanted)


def disparity_and_depth(given: Given) -> Case:
    """Turn disparity into depth; what is not above 0, or gives no number, is no value."""
    size = given.size(*SIZE)
    values = given.values(0.5, 120, size)
    ours = given.precision.array(values)

    def wanted() -> Outputs:
        depth_m = FX * BASELINE_M / values
        held = (values > 0) & (depth_m <= np.finfo(np.float32).max)
        return {"depth": np.where(held, depth_m, 0)}

    return Case(lambda: {"depth": geometry.convert_disparity(ours, FX, BASELINE_M)}, wanted)


def rigid_motion(given: Given) -> Case:
    """Move points by a pose, and back by its inverse."""
    size = given.size(COUNT)
    xyz_m = np.stack(list(given.values(0.1, 80, (3, *size), signed=True)), axis=1)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(given), given.far + given.random.uniform(-5, 5, 3)
    ours = given.precision.array(xyz_m)

    def found() -> Outputs:
        return {"moved": geometry.transform(pose, ours), "inverse": geometry.invert(pose)}

    def wanted() -> Outputs:
        whole = np.eye(4)
        whole[:3, :3], whole[:3, 3] = pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]
        return {"moved": _sum_of(_terms(pose, xyz_m)), "inverse": whole}

    with np.errstate(all="ignore"):
        parts = np.abs(_terms(pose, xyz_m))
        size_m = np.nanmax(np.where(np.isfinite(parts), parts, 0), axis=2, initial=1e-300)
    return Case(found, wanted, scale={"moved": size_m, "inverse": max(1.0, float(np.abs(pose).max()))}, spreads=True)


def _terms(pose: Any, xyz_m: Floats) -> Floats:
    """Return the four parts (n, 3, 4) of each coordinate of the moved points."""
    return np.concatenate([xyz_m[:, None] * pose[:3, :3], np.broadcast_to(pose[:3, 3:], (len(xyz_m), 3, 1))], axis=2)


def _sum_of(parts: Floats) -> Floats:
    return np.asarray(parts.astype(np.longdouble).sum(axis=2), np.float64)


def camera_of(size: tuple[int, ...]) -> Camera:
    """Return a camera of an image of this size."""
    height, width = size
    K = np.array([[FX, 0, (width - 1) / 2], [0, 0.97 * FX, (height - 1) / 2], [0, 0, 1.0]])
    return Camera(K, (height, width))


def turned(given: Given) -> Any:
    """Return a random rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.random(random_state=int(given.random.integers(1 << 30))).as_matrix()


NO_DIRECTION = without("denormals", why="a point's coordinates have no digits left that say where it lies")
ROUTINES = (
    Routine("projection", "priors/geometry.py", project, NO_POSES, NO_BFLOAT),
    Routine(
        "unprojection, then projection", "priors/geometry.py", there_and_back, {**NO_POSES, **NO_DIRECTION}, NO_BFLOAT
    ),
    Routine("range <-> depth", "priors/geometry.py", range_and_depth, NO_POSES, NO_BFLOAT),
    Routine("disparity <-> depth", "priors/geometry.py", disparity_and_depth, NO_POSES, NO_BFLOAT),
    Routine("rigid motion", "priors/geometry.py", rigid_motion, {}, NO_BFLOAT),
)
