"""Depth from a stereo pair: semi-global matching, edge-aware smoothing and filling, a calibrated confidence."""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from priors.diffusion import diffuse
from priors.errors import DataError
from priors.matching import match, to_grey
from priors.offset import NONE, Offset, measure_offset
from priors.types import Camera, Depth, FloatMap, Frame, Image, Matrix

LARGEST_M = 250.0  # what a depth PNG holds, less a little; a pair sees no difference beyond
TOLERANCE_M = 1.0
ERROR_PX, ERROR_UNMATCHED_PX, ERROR_PER_ROUGHNESS, ERROR_PER_SLOPE = 0.37, 2.5, 0.3, 0.8
ROUGHNESS_WINDOW_PX = 7
STEEP = 3.0  # px per px: what is steeper is an edge


@dataclass(frozen=True)
class Stereo:
    """Match the pair, smooth and fill the disparity by what the image says, and tell how far to trust it.

    Every pixel has a value where anything could be matched. The confidence is the probability that the depth is right
    within 1 m: low where the surface is far, the match was missing or rough, or an edge is near.
    """

    max_disparity_px: int | None = None
    """Largest disparity searched; default: what each pair's scene needs."""
    offset_px: tuple[float, float, float] | None = None
    """a b c: a + b X + c X^2 is added to the disparity, X = (column - cx) / fx: what the pair's rectification is off.
    Default: measured against the LiDAR sweep of the drive's first frame; 0 0 0 where there is none. Give 0 0 0 for
    depth from the images alone."""

    def __post_init__(self) -> None:
        if self.max_disparity_px is not None and self.max_disparity_px < 1:
            raise DataError(f"stereo: max disparity is {self.max_disparity_px}, expected 1 or more pixels")

    @property
    def reads(self) -> tuple[str, ...]:
        """Return what a frame must have."""
        return ("image", "other")

    def resolve(self, frame: Frame) -> Self:
        """Return the config with the offset measured on this frame, or zero without a LiDAR."""
        if self.offset_px is not None:
            return self
        return replace(self, offset_px=calibrate(frame, self.max_disparity_px))

    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis.

        Raises DataError where the pair or its baseline is missing, or the two images differ in size.
        """
        fx_baseline = frame.camera.fx * baseline(frame)
        image, other = read_pair(frame)
        matched_px = match(image, other, self.max_disparity_px)
        disparity_px, evidence = diffuse(matched_px, to_grey(image))
        error_px = expected_error(matched_px, disparity_px, evidence)
        disparity_px, error_px = unmirror(frame, disparity_px), unmirror(frame, error_px)
        found = disparity_px > 0
        disparity_px = disparity_px + offset_row(frame.camera, self.offset_px or NONE)
        np.maximum(disparity_px, np.float32(fx_baseline / LARGEST_M), out=disparity_px)
        depth_m = np.where(found, np.float32(fx_baseline) / disparity_px, np.float32(0))
        confidence = np.where(found, probability(disparity_px, error_px, fx_baseline), np.float32(0))
        return Depth(depth_m, confidence)


def baseline(frame: Frame) -> float:
    """Return the pair's baseline in metres, or raise DataError where there is none."""
    if frame.baseline_m is None or not frame.baseline_m > 0:
        frame.other()  # says why, where the drive knows
        raise DataError(f"frame {frame.id}: the stereo baseline is not known: check the calibration of both cameras")
    return frame.baseline_m


def read_pair(frame: Frame) -> tuple[Image, Image]:
    """Read the pair with this camera as the left one: in the mirror, a right camera is."""
    image, other = frame.image(), frame.other()
    if image.shape != other.shape:
        sizes = " and ".join("x".join(map(str, (a.shape[1], a.shape[0], *a.shape[2:]))) for a in (image, other))
        raise DataError(f"frame {frame.id}: the two images of the pair are {sizes}: expected equal, resize neither")
    if frame.side == "left":
        return image, other
    return np.ascontiguousarray(image[:, ::-1]), np.ascontiguousarray(other[:, ::-1])


def calibrate(frame: Frame, max_disparity_px: int | None) -> Offset:
    """Measure the pair's disparity offset against the frame's own sweep; zeros where either is missing."""
    if frame.T_cam_lidar is None or frame.baseline_m is None or not (frame.has("sweep") and frame.has("other")):
        return NONE
    sweep = frame.sweep()
    if sweep is None:
        return NONE
    image, other = read_pair(frame)
    camera, T_cam_lidar = frame.camera, frame.T_cam_lidar
    if frame.side == "right":
        camera, T_cam_lidar = mirror(camera, T_cam_lidar)
    a, b, c = measure_offset(image, other, camera, frame.baseline_m, sweep, T_cam_lidar, max_disparity_px)
    return (a, b, c) if frame.side == "left" else (a, -b, c)


def mirror(camera: Camera, T_cam_lidar: Matrix) -> tuple[Camera, Matrix]:
    """Return the camera and the LiDAR's place as the horizontally mirrored image has them."""
    K = camera.K.copy()
    K[0, 2] = camera.size[1] - 1 - K[0, 2]
    return Camera(K, camera.size), np.diag([-1.0, 1.0, 1.0, 1.0]) @ T_cam_lidar


def unmirror(frame: Frame, map_: FloatMap) -> FloatMap:
    """Turn a map made from `read_pair` back into the frame's own view."""
    return map_ if frame.side == "left" else np.ascontiguousarray(map_[:, ::-1])


def offset_row(camera: Camera, offset_px: Offset) -> FloatMap:
    """Return the offset of every column's disparity: (1, width) px."""
    X = (np.arange(camera.size[1]) - camera.K[0, 2]) / camera.fx
    return np.polynomial.polynomial.polyval(X, offset_px)[None].astype(np.float32)


def expected_error(matched_px: FloatMap, disparity_px: FloatMap, evidence: FloatMap) -> FloatMap:
    """Return the mean absolute error to expect of a disparity (height, width), px.

    It grows where little was matched, where matches scatter about the smoothed surface, and at steps: a linear fit to
    errors on grey KITTI odometry pairs and the procedural street, see docs/methods/stereo.md.
    """
    window = (ROUGHNESS_WINDOW_PX, ROUGHNESS_WINDOW_PX)
    matched = (matched_px > 0).astype(np.float32)
    scatter = cv2.blur(np.abs(matched_px - disparity_px) * matched, window)
    roughness = scatter / np.maximum(cv2.blur(matched, window), np.float32(0.02))
    slope = np.abs(cv2.Sobel(disparity_px, cv2.CV_32F, 1, 0, scale=1 / 8))
    error_px = np.float32(ERROR_PX + ERROR_UNMATCHED_PX) - np.float32(ERROR_UNMATCHED_PX) * evidence
    error_px += np.float32(ERROR_PER_ROUGHNESS) * np.minimum(roughness, np.float32(STEEP))
    error_px += np.float32(ERROR_PER_SLOPE) * np.minimum(slope, np.float32(STEEP))
    return error_px


def probability(disparity_px: FloatMap, error_px: FloatMap, fx_baseline: float) -> FloatMap:
    """Return the probability in [0, 1] that the depth is within 1 m, for Laplace-distributed errors of this mean."""
    allowed_px = np.square(disparity_px) * np.float32(TOLERANCE_M / fx_baseline)
    return np.asarray(-np.expm1(-allowed_px / error_px), dtype=np.float32)
