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

from pathlib import Path
from typing import Any

import numpy as np

from priors.drives._files import check_baseline
from priors.drives._rectified import RectifiedCamera, rectify_pair, to_pose
from priors.errors import DataError
from priors.text import read_json
from priors.types import Camera, Matrix

RING_SIZE = (1200, 1920)
STEREO_SIZE = (2056, 2464)


class LogCalibration:
    """A log's calibration file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        entries = read_json(path, "download the log's calibration again").get("camera_data_")
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
        cameras, baseline_m = rectify_pair(K, T_ego, STEREO_SIZE)
        return *cameras, check_baseline(baseline_m, f"from {left} to {right}", self.path)

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
