"""Rows of the table: LiDAR points untwisted, accumulated by poses, and how well their neighbours speak for them."""

import math

import numpy as np

from priors.geometry import untwist
from priors.methods.lidar import AGREE, STEADY, accumulate, confidence
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.projection import NO_DIRECTION, camera_of, turned
from priors.stress.routine import FLOAT32_ONLY, NO_MASK, NO_POSES, Case, Outputs, Routine
from priors.types import Frame, Matrix, Sweep

SIZE = (10, 14)
OFFSETS = (0, -1, 1)
OFF_CENTRE_PX = 0.3
SUPPORT_PX = 4


def accumulation(given: Given) -> Case:
    """Splat three sweeps, each taken from its own place, into one map; the nearest point of a pixel wins."""
    size = given.size(*SIZE)
    camera = camera_of(size)
    poses = [_pose(given, metres) for metres in (0.0, -1.5, 1.5)]
    sweeps = {o: _sweep(given, size, poses[0], pose) for o, pose in zip(OFFSETS, poses, strict=True)}
    place = np.eye(4)
    frame = Frame("0", camera, {"sweep": lambda offset: sweeps.get(offset)}, {}, poses[0], place)

    def wanted() -> Outputs:
        depth_m, source = np.full(size, np.inf), np.full(size, None)
        for offset, pose in zip(OFFSETS, poses, strict=True):
            points_m = sweeps[offset].xyz_m.astype(np.longdouble) @ pose[:3, :3].T.astype(np.longdouble)
            seen_m = (points_m + (pose[:3, 3] - poses[0][:3, 3])) @ poses[0][:3, :3].astype(np.longdouble)
            for x, y, z in seen_m.astype(np.float64):
                if not 0 < z < np.inf:
                    continue
                at = [camera.K[1, 1] * y / z + camera.K[1, 2], camera.K[0, 0] * x / z + camera.K[0, 2]]
                row, column = (math.floor(px + 0.5) for px in at)
                if not (0 <= row < size[0] and 0 <= column < size[1]):
                    continue
                nearer = 1 if source[row, column] in (None, offset) else 1 - AGREE
                if z < depth_m[row, column] * nearer:
                    depth_m[row, column], source[row, column] = z, offset
        return {"depth": depth_m}

    return Case(lambda: {"depth": accumulate(frame, 3, motion=False)}, wanted)


def _pose(given: Given, ahead_m: float) -> Matrix:
    """Return a pose (4, 4) of camera or scanner on its way, wherever the world's origin is."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(given), given.far + np.array([0, 0, ahead_m])
    return pose


def _sweep(given: Given, size: tuple[int, ...], T_world_cam: Matrix, T_world_lidar: Matrix) -> Sweep:
    """Return points that fall near the middles of pixels, so that no rounding moves one into the next."""
    K = camera_of(size).K
    rows, columns = (each.ravel() for each in np.indices(size))
    off_px = given.random.uniform(-OFF_CENTRE_PX, OFF_CENTRE_PX, (2, rows.size))
    ray = np.stack([(columns + off_px[0] - K[0, 2]) / K[0, 0], (rows + off_px[1] - K[1, 2]) / K[1, 1], 1 + 0 * rows])
    depth_m = given.values(3, 80, (rows.size,))
    with np.errstate(all="ignore"):
        seen_m = (ray * depth_m).T @ T_world_cam[:3, :3].T + (T_world_cam[:3, 3] - T_world_lidar[:3, 3])
        xyz_m = (seen_m @ T_world_lidar[:3, :3]).astype(np.float32)
    return Sweep(xyz_m, T_world_lidar)


def untwisting(given: Given) -> Case:
    """Take the ego motion out of a sweep: each point moves along the motion by its own time."""
    size = given.size(150)
    xyz_m = np.stack(list(given.values(0.5, 80, (3, *size), signed=True)), axis=1)
    time_s = given.precision.rounded(given.random.uniform(-0.1, 0.1, size))
    linear, angular = np.array([14.0, 0.4, -0.1]), np.array([0.01, -0.03, 0.6])
    sweep = Sweep(
        given.precision.array(xyz_m),
        None,
        given.precision.array(time_s),
        np.concatenate([linear, angular]),
    )

    def wanted() -> Outputs:
        from scipy.spatial.transform import Rotation

        turns = Rotation.from_rotvec(time_s[:, None] * angular).as_matrix()
        return {"points": np.einsum("nij,nj->ni", turns, xyz_m) + time_s[:, None] * linear}

    with np.errstate(all="ignore"):
        length_m = np.where(np.isfinite(xyz_m), abs(xyz_m), 0).max(axis=1, keepdims=True)
    scale = {"points": np.broadcast_to(np.maximum(length_m, 0.1), xyz_m.shape)}
    return Case(lambda: {"points": untwist(sweep)}, wanted, scale, spreads=True)


def neighbours_support(given: Given) -> Case:
    """Ask how dense and how steady the values around each value are."""
    size = given.size(18, 26)
    depth_m: Floats = np.where(given.mask(0.5, size), given.values(2, 80, size), np.inf)
    depth_m = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.inf)  # the splat leaves no others
    ours, reach = given.precision.array(depth_m), SUPPORT_PX

    def wanted() -> Outputs:
        out = np.zeros(size)
        for row, column in np.argwhere(np.isfinite(depth_m)):
            window = depth_m[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
            inverse = 1 / window[np.isfinite(window)].astype(np.longdouble)
            spread2 = ((inverse - inverse.mean()) ** 2).mean() / inverse.mean() ** 2
            out[row, column] = inverse.size / window.size / (1 + spread2 / STEADY**2)
        return {"support": out}

    return Case(lambda: {"support": confidence(ours, SUPPORT_PX / 0.0055)}, wanted)


ROUTINES = (
    Routine("LiDAR accumulation", "priors/methods/lidar.py", accumulation, {**NO_DIRECTION, **NO_MASK}, FLOAT32_ONLY),
    Routine("untwisting", "priors/geometry.py", untwisting, {**NO_POSES, **NO_MASK}, FLOAT32_ONLY),
    Routine("neighbours' support", "priors/methods/lidar.py", neighbours_support, NO_POSES, FLOAT32_ONLY),
)
