"""What two sensors of a frame say about each other, measured roughly and fast: the audit's evidence."""

from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from priors.geometry import convert_disparity, project, transform, untwist
from priors.pairs import matching
from priors.types import FloatMap, Frame, Image, Sweep

WIDEST_PX = 1600  # wider images are halved: Argoverse's pair is then as fine as KITTI's
CORNERS, PATCH_PX, SEARCH_ROWS_PX, ALIKE = 150, 15, 12, 0.85


def match_corners(image: Image, other: Image, side: Literal["left", "right"]) -> npt.NDArray[np.float64] | None:
    """Find the corners of a grey image in the other camera's, on either side and a few rows up and down.

    Args:
        image: (height, width).
        other: the other camera's, of the same size.
        side: which eye of the pair `image` is.

    Returns:
        (n, 2) disparity, negative where it goes the wrong way, and vertical offset, px of the image as given; None
        where it has no corner.
    """
    scale = 1
    while image.shape[1] > WIDEST_PX:
        image, other, scale = matching.halve(image), matching.halve(other), 2 * scale
    corners = cv2.goodFeaturesToTrack(image, CORNERS, 0.02, PATCH_PX)
    if corners is None:
        return None
    towards = 1 if side == "left" else -1
    shifts = [shift for x, y in corners.reshape(-1, 2) if (shift := _find_patch(image, other, round(x), round(y)))]
    return np.array(shifts, dtype=np.float64).reshape(-1, 2) * (towards * scale, scale)


def _find_patch(image: Image, other: Image, x: int, y: int) -> tuple[float, float] | None:
    """Find the patch around (x, y) in the other image, on either side: (x - x', y' - y), or None where unsure."""
    half, reach = PATCH_PX // 2, image.shape[1] // 5
    top, left = y - half - SEARCH_ROWS_PX, max(0, x - half - reach)
    bottom, right = y + half + 1 + SEARCH_ROWS_PX, x + half + 1 + reach
    if top < 0 or bottom > image.shape[0] or x < half or x + half >= image.shape[1]:
        return None
    patch = image[y - half : y + half + 1, x - half : x + half + 1]
    alike = cv2.matchTemplate(other[top:bottom, left:right], patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(alike)
    if best < ALIKE or not (0 < row < alike.shape[0] - 1 and 0 < column < alike.shape[1] - 1):
        return None
    fine_x = _peak(*alike[row, column - 1 : column + 2].tolist())
    fine_y = _peak(*alike[row - 1 : row + 2, column].tolist())
    return x - (left + half + column + fine_x), top + half + row + fine_y - y


def _peak(before: float, middle: float, after: float) -> float:
    """Return where the parabola through three neighbouring values peaks, in (-0.5, 0.5) of the middle one."""
    bend = before - 2 * middle + after
    return 0.0 if bend >= 0 else 0.5 * (before - after) / bend


def compare_sweep(frame: Frame, sweep: Sweep, stereo_px: FloatMap) -> npt.NDArray[np.float64] | None:
    """Return (n, 2) disparities, px: of LiDAR points, and of stereo (height, width) at their pixels.

    None where the baseline or the LiDAR's place is not known.
    """
    if not frame.baseline_m or frame.T_cam_lidar is None:
        return None
    uv_px, depth_m = project(frame.camera, transform(frame.T_cam_lidar, untwist(sweep)))
    height, width = frame.camera.size
    inside = (depth_m > 1) & (uv_px >= 0).all(axis=1) & (uv_px[:, 0] <= width - 1) & (uv_px[:, 1] <= height - 1)
    cell = np.rint(uv_px[inside]).astype(np.int64)
    seen_px = stereo_px[cell[:, 1], cell[:, 0]]
    lidar_px = convert_disparity(depth_m[inside].astype(np.float32), frame.camera.fx, frame.baseline_m)
    seen = (seen_px > 0) & (lidar_px > 0)
    return np.stack([lidar_px[seen], seen_px[seen]], axis=1).astype(np.float64)
