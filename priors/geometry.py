"""Points, pixels and the three things people call depth.

Frames: `T_a_b` maps points from b to a. Pixels: the centre of the top-left pixel is (0, 0).
`depth_m` is the camera's z, `range_m` the distance along the ray, `disparity_px` the column shift.
"""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from priors.types import Camera, FloatMap, Matrix, Sweep

Points = npt.NDArray[np.floating]
Kind = TypeVar("Kind", bound=np.generic)


def transform(T_a_b: Matrix, xyz_b: Points) -> Points:
    """Map points (n, 3) from frame b to frame a; keeps the points' dtype. A point that is not finite stays so."""
    kind = np.promote_types(xyz_b.dtype, np.float32)  # float16 is too coarse to compute in
    with np.errstate(invalid="ignore", over="ignore"):
        moved = xyz_b.astype(kind, copy=False) @ T_a_b[:3, :3].astype(kind).T + T_a_b[:3, 3].astype(kind)
        return moved.astype(xyz_b.dtype, copy=False)


def invert(T_a_b: Matrix) -> Matrix:
    """Invert a rigid transform (4, 4)."""
    T_b_a = np.eye(4)
    T_b_a[:3, :3] = T_a_b[:3, :3].T
    T_b_a[:3, 3] = -T_a_b[:3, :3].T @ T_a_b[:3, 3]
    return T_b_a


def project(camera: Camera, xyz_cam: Points) -> tuple[Points, Points]:
    """Project points (n, 3), metres, in front of the camera.

    Returns:
        uv_px (n, 2) and depth_m (n,). Points with z <= 0 give non-finite or mirrored pixels: mask by depth.
    """
    depth_m = xyz_cam[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = camera.K[0, 0] * xyz_cam[:, 0] / depth_m + camera.K[0, 2]
        v = camera.K[1, 1] * xyz_cam[:, 1] / depth_m + camera.K[1, 2]
        return np.stack([u, v], axis=1).astype(xyz_cam.dtype), depth_m


def rays(camera: Camera) -> npt.NDArray[np.float64]:
    """Return the direction (height, width, 3) through every pixel's centre, scaled so that z = 1."""
    height, width = camera.size
    x = (np.arange(width) - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(height) - camera.K[1, 2]) / camera.K[1, 1]
    directions = np.ones((height, width, 3))
    directions[..., 0], directions[..., 1] = x[None, :], y[:, None]
    return directions


def unproject(camera: Camera, depth_m: FloatMap) -> Points:
    """Turn a depth map (height, width) into points (n, 3) in the camera's frame, row by row, invalid left out."""
    valid = depth_m > 0
    return (rays(camera)[valid] * depth_m[valid, None]).astype(np.float32)


def range_from_depth(camera: Camera, depth_m: FloatMap) -> FloatMap:
    """Turn camera-z depth into distance along the ray, metres; 0 stays 0."""
    return (depth_m * np.linalg.norm(rays(camera), axis=-1)).astype(np.float32)


def depth_from_range(camera: Camera, range_m: FloatMap) -> FloatMap:
    """Turn distance along the ray into camera-z depth, metres; 0 stays 0."""
    return (range_m / np.linalg.norm(rays(camera), axis=-1)).astype(np.float32)


def convert_disparity(map_: FloatMap, fx_px: float, baseline_m: float) -> FloatMap:
    """Turn disparity (px) into depth (m) or back: both are fx * baseline / other; values <= 0 become 0."""
    out = np.zeros_like(map_, dtype=np.float32)
    with np.errstate(over="ignore"):
        np.divide(np.float32(fx_px * baseline_m), map_, out=out, where=map_ > 0)
    out[~np.isfinite(out)] = 0  # denormal input: no surface is that far, nor that near
    return out


def resize(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera of the image resized to (height, width); pixel centres stay at integers."""
    scale_y, scale_x = size[0] / camera.size[0], size[1] / camera.size[1]
    K = camera.K.copy()
    K[0] *= scale_x
    K[1] *= scale_y
    K[0, 2] += 0.5 * scale_x - 0.5
    K[1, 2] += 0.5 * scale_y - 0.5
    return Camera(K, size)


def crop(camera: Camera, top: int, left: int, size: tuple[int, int]) -> Camera:
    """Return the camera of the image's crop that starts at (top, left) and is (height, width) large."""
    K = camera.K.copy()
    K[0, 2] -= left
    K[1, 2] -= top
    return Camera(K, size)


def mirror(camera: Camera) -> Camera:
    """Return the camera whose image is this one's, mirrored from left to right: see `mirror_columns`."""
    K = camera.K.copy()
    K[0, 2] = camera.size[1] - 1 - K[0, 2]
    return Camera(K, camera.size)


def mirror_columns(map_: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
    """Mirror an image or a map (height, width, ...) from left to right."""
    return np.ascontiguousarray(map_[:, ::-1])


def scatter_nearest(uv_px: Points, depth_m: Points, size: tuple[int, int]) -> FloatMap:
    """Put points into a depth map (height, width): nearest pixel, nearest point wins, 0 where none falls.

    Points outside the image, behind the camera, or whose depth float32 cannot hold as a number above 0 are left out.
    """
    height, width = size
    with np.errstate(invalid="ignore", over="ignore"):
        depth_m = depth_m.astype(np.float32)
        inside = (depth_m > 0) & np.isfinite(depth_m)
        inside &= (uv_px > -0.5).all(axis=1) & (uv_px[:, 0] < width - 0.5) & (uv_px[:, 1] < height - 0.5)
    cell = np.rint(uv_px[inside]).astype(np.int64)
    flat = np.full(height * width, np.inf, dtype=np.float32)
    np.minimum.at(flat, cell[:, 1] * width + cell[:, 0], depth_m[inside])
    flat[np.isinf(flat)] = 0
    return flat.reshape(size)


def untwist(sweep: Sweep) -> npt.NDArray[np.float32]:
    """Return the sweep's points (n, 3), metres, with the ego motion during the rotation taken out.

    Constant velocity: p(t_ref) = Exp(t * angular) p + t * linear. Where the motion is compensated already, or unknown,
    the points come back as they are.
    """
    if sweep.time_s is None or sweep.velocity is None:
        return sweep.xyz_m
    from priors.kernels.untwist import untwist_points

    return untwist_points(sweep.xyz_m, sweep.time_s, sweep.velocity)
