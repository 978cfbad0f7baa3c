"""Rectified cameras of a vehicle: what a frame shows, how stored images get there, and a pair turned to rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from priors.errors import DataError
from priors.geometry import invert
from priors.types import Camera, Image, Matrix


@dataclass(frozen=True)
class RectifiedCamera:
    """One camera as the frames show it, and how its stored images get there."""

    camera: Camera
    T_ego_cam: Matrix | None
    """(4, 4); None where the calibration does not place the rectified camera on the vehicle."""
    warp: Matrix | None = None
    """(3, 3) homography from stored to rectified pixels; None: the images are stored as the camera sees."""

    def rectify(self, image: Image) -> Image:
        """Turn a stored image into the camera's; its size stays."""
        if self.warp is None:
            return image
        height, width = self.camera.size
        return np.asarray(cv2.warpPerspective(image, self.warp, (width, height), flags=cv2.INTER_LINEAR), np.uint8)


def rectify_pair(
    K: Sequence[Matrix], T_ego_cam: Sequence[Matrix], size: tuple[int, int]
) -> tuple[tuple[RectifiedCamera, RectifiedCamera], float]:
    """Turn a left and a right camera so that their rows match (Bouguet's method, OpenCV's stereoRectify, alpha 0).

    Args:
        K: (3, 3) of each, pixels.
        T_ego_cam: (4, 4) of each on the vehicle, metres.
        size: (height, width) of the images.

    Returns:
        the two cameras, of one K and size, and the baseline in metres; below 0 where they are swapped.
    """
    T_right_left = invert(T_ego_cam[1]) @ T_ego_cam[0]
    height, width = size
    none = np.zeros((1, 5))
    turns_projections = cv2.stereoRectify(
        K[0], none, K[1], none, (width, height),
        T_right_left[:3, :3].copy(), T_right_left[:3, 3:].copy(), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )  # fmt: skip
    turns, P_right = turns_projections[:2], turns_projections[3]
    camera = Camera(np.asarray(P_right[:, :3], np.float64), size)
    cameras = []
    for K_raw, T_ego_raw, R_rect_raw in zip(K, T_ego_cam, turns, strict=True):
        T_raw_rect = np.eye(4)
        T_raw_rect[:3, :3] = R_rect_raw.T
        warp = camera.K @ R_rect_raw @ np.linalg.inv(K_raw)
        cameras.append(RectifiedCamera(camera, T_ego_raw @ T_raw_rect, warp))
    return (cameras[0], cameras[1]), float(-P_right[0, 3] / P_right[0, 0])


def to_pose(rotation_wxyz: object, translation_m: object, where: str) -> Matrix:
    """Turn a quaternion (w, x, y, z) and a translation, metres, into (4, 4).

    Raises:
        DataError: they are not 4 and 3 finite numbers; `where` names them.
    """
    try:
        q, t = np.array(rotation_wxyz, dtype=np.float64), np.array(translation_m, dtype=np.float64)
    except (TypeError, ValueError):
        q = t = np.zeros(0)
    if q.shape != (4,) or t.shape != (3,) or not np.isfinite([*q, *t]).all() or np.linalg.norm(q) < 1e-6:
        raise DataError(f"{where}: expected a quaternion (w x y z) and 3 metres, all finite: repair or download again")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([*q[1:], q[0]]).as_matrix()
    T[:3, 3] = t
    return T
