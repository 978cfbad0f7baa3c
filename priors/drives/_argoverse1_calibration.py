"""Argoverse 1 calibration: vehicle_calibration_info.json and the stereo release's vehicle_calibration_stereo_info.json.

Facts (argoverse-api: README, utils/calibration.py, issues 37, 50, 81):
- The images are undistorted already: `distortion_coefficients_` describe the lens as it was. Applying them is wrong.
- The stereo pair of the tracking logs is not rectified: its cameras are turned by about 1 degree (60 px) against each
  other. `rectify_pair` turns them as the stereo release does: OpenCV's stereoRectify with alpha 0 gives the release's
  focal length, centre and Txf_ to 3e-6 px (tests/test_drives_argoverse1.py).
- In the stereo release `Txf_` is -focal x baseline, the `_rect` cameras' rotation maps from the rectified camera to
  the raw one, and `stereo_front_left_rect_refined` is the rectified left camera on the vehicle.
- Quaternions are (w, x, y, z). The vehicle's frame is x forward, y left, z up, at the rear axle.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from priors.drives._files import check_baseline
from priors.errors import DataError
from priors.geometry import invert
from priors.text import read_json
from priors.types import Camera, Image, Matrix

RING_SIZE = (1200, 1920)
STEREO_SIZE = (2056, 2464)


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


class LogCalibration:
    """A log's calibration file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        entries = read_json(path).get("camera_data_")
        if not isinstance(entries, list):
            raise DataError(f"{path}: calibration key camera_data_ is missing: download the log again")
        self._values = {e.get("key"): e.get("value") for e in entries if isinstance(e, dict)}

    def ring_camera(self, name: str) -> RectifiedCamera:
        """Return a camera of the ring: its images are stored as the frames show them."""
        return RectifiedCamera(Camera(self._K(name), RING_SIZE), self._T_ego_cam(name))

    def rectify_pair(self, left: str, right: str) -> tuple[RectifiedCamera, RectifiedCamera, float]:
        """Rectify the pair of a tracking log: its cameras and their baseline in metres."""
        K = [self._K(name) for name in (left, right)]
        T_ego = [self._T_ego_cam(name) for name in (left, right)]
        T_right_left = invert(T_ego[1]) @ T_ego[0]
        height, width = STEREO_SIZE
        none = np.zeros((1, 5))
        turns_projections = cv2.stereoRectify(
            K[0], none, K[1], none, (width, height),
            T_right_left[:3, :3].copy(), T_right_left[:3, 3:].copy(), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
        )  # fmt: skip
        turns, P_right = turns_projections[:2], turns_projections[3]
        camera = Camera(np.asarray(P_right[:, :3], np.float64), STEREO_SIZE)
        cameras = []
        for K_raw, T_ego_raw, R_rect_raw in zip(K, T_ego, turns, strict=True):
            T_raw_rect = np.eye(4)
            T_raw_rect[:3, :3] = R_rect_raw.T
            warp = camera.K @ R_rect_raw @ np.linalg.inv(K_raw)
            cameras.append(RectifiedCamera(camera, T_ego_raw @ T_raw_rect, warp))
        baseline_m = check_baseline(float(-P_right[0, 3] / P_right[0, 0]), f"from {left} to {right}", self.path)
        return cameras[0], cameras[1], baseline_m

    def rectified_pair(self, left: str, right: str) -> tuple[RectifiedCamera, RectifiedCamera, float]:
        """Return the stereo release's pair and its baseline in metres: -Txf_ / focal length of the right camera."""
        K, K_right = self._K(left), self._K(right)
        if not np.allclose(K, K_right, atol=1e-3):
            raise DataError(f"{self.path}: {left} and {right} differ in focal length or centre: download the log again")
        baseline_m = -self._number(self._value(right), "Txf_", right) / K_right[0, 0]
        check_baseline(baseline_m, f"by {right}'s Txf_", self.path)
        T_left_right = np.eye(4)
        T_left_right[0, 3] = baseline_m
        placed = f"{left}_refined"
        T_ego_left = self._T_ego_cam(placed) if f"image_raw_{placed}" in self._values else None
        T_ego_right = None if T_ego_left is None else T_ego_left @ T_left_right
        camera = Camera(K, STEREO_SIZE)
        return RectifiedCamera(camera, T_ego_left), RectifiedCamera(camera, T_ego_right), baseline_m

    def _value(self, name: str) -> dict[str, Any]:
        value = self._values.get(f"image_raw_{name}")
        if not isinstance(value, dict):
            raise DataError(f"{self.path}: calibration key image_raw_{name} is missing: download the log again")
        return value

    def _number(self, value: dict[str, Any], key: str, name: str) -> float:
        number = value.get(key)
        if not isinstance(number, (int, float)) or not np.isfinite(number):
            raise DataError(f"{self.path}: {name}: {key} should be a number, found {number!r}: download the log again")
        return float(number)

    def _K(self, name: str) -> Matrix:
        value = self._value(name)
        K = np.eye(3)
        for axis, letter in enumerate("xy"):
            K[axis, axis] = self._number(value, f"focal_length_{letter}_px_", name)
            K[axis, 2] = self._number(value, f"focal_center_{letter}_px_", name)
        if K[0, 0] <= 0 or K[1, 1] <= 0 or abs(self._number(value, "skew_", name)) > 1e-6:
            raise DataError(f"{self.path}: {name} is no pinhole (focal length <= 0 or skew): download the log again")
        return K

    def _T_ego_cam(self, name: str) -> Matrix:
        pose = self._value(name).get("vehicle_SE3_camera_")
        rotation = pose.get("rotation", {}).get("coefficients") if isinstance(pose, dict) else None
        translation = pose.get("translation") if isinstance(pose, dict) else None
        return to_pose(rotation, translation, f"{self.path}: {name}: vehicle_SE3_camera_")


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
