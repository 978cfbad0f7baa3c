"""Semi-global matching of a rectified pair: images in, disparity of the left view out.

The core is OpenCV's matcher (Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information",
2008). Disparities are pixels of the left image, >= 0; 0 = no value. Left x matches right x - disparity.
"""

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.types import FloatMap, Image

RANGE_STEP_PX = 16  # OpenCV wants a multiple of 16 disparities
WINDOW_PX = 5
PENALTY_SMALL, PENALTY_LARGE = 8, 32  # per pixel of the window's area
UNIQUE_PERCENT = 15  # the best match must beat all others by this
AGREE_PX = 1.0  # of the match downwards and the one upwards
SPECKLE_SHARE, SPECKLE_STEP_PX = 1 / 1200, 1  # islands of that share of the image are mismatches


def match(left: Image, right: Image, max_disparity_px: int | None = None, window: int = WINDOW_PX) -> FloatMap:
    """Match a pair of equal size, (height, width) or (height, width, 3), at full resolution.

    Matches twice, downwards and upwards, and keeps the mean of what agrees: the matcher's vertical path only runs down,
    so that on a road it lags some 0.6 rows (0.2 px at KITTI's camera height) behind; upwards it lags the other way.

    Args:
        left: the left view.
        right: the right view.
        max_disparity_px: largest disparity searched; None takes it from the scene, by a quarter-size match.
        window: side of the matching window, odd, pixels.

    Returns:
        disparity_px (height, width) of the left view, checked against the right view; 0 = no value.
    """
    left, right = as_grey(left), as_grey(right)
    if max_disparity_px is None:
        max_disparity_px = find_max_disparity(left, right)
    down_px = _match_grey(left, right, max_disparity_px, window)
    up_px = _match_grey(left[::-1], right[::-1], max_disparity_px, window)[::-1]
    agree = (down_px > 0) & (up_px > 0) & (np.abs(down_px - up_px) <= AGREE_PX)
    return np.where(agree, (down_px + up_px) * np.float32(0.5), np.float32(0))


def quick_match(left: Image, right: Image, max_disparity_px: int | None = None) -> FloatMap:
    """Match a pair at half size (an eighth of the work), for checks that need no fine detail.

    Returns:
        disparity_px (height, width) at the left view's own size and scale, left-right checked; 0 = no value.
    """
    height, width = left.shape[:2]
    half = half_match(left, right, max_disparity_px)
    size = (2 * half.shape[1], 2 * half.shape[0])
    full = cv2.resize(half, size, interpolation=cv2.INTER_NEAREST)[:height, :width]
    return np.multiply(full, np.float32(2), dtype=np.float32)


def half_match(left: Image, right: Image, max_disparity_px: int | None = None) -> FloatMap:
    """Match a pair at half size.

    Returns:
        disparity_px (half the height, half the width, rounded up) in pixels of the small images; 0 = no value.
    """
    left, right = halve(as_grey(left)), halve(as_grey(right))
    if max_disparity_px is None:
        max_disparity_px = 2 * find_max_disparity(left, right)
    return _match_grey(left, right, (max_disparity_px + 1) // 2, 3)


def find_max_disparity(left: Image, right: Image) -> int:
    """Find how large disparities get in this pair, px: from a match at a quarter of the size."""
    return largest_disparity(quarter_match(left, right), left.shape[1])


def quarter_match(left: Image, right: Image) -> FloatMap:
    """Match a pair at a quarter of its size, over every disparity that fits into it: a few milliseconds.

    Returns:
        disparity_px (about height / 4, about width / 4) in pixels of the small images; 0 = no value.
    """
    small_left, small_right = halve(halve(as_grey(left))), halve(halve(as_grey(right)))
    return _match_grey(small_left, small_right, small_left.shape[1] // 4, 5)


def largest_disparity(small_px: FloatMap, width: int) -> int:
    """Tell from a quarter-size match how large disparities get in images of this width, px.

    One in 2000 of the matched pixels may lie beyond: that many are mismatches even in a good pair.
    """
    matched_px = small_px[small_px > 0]
    if matched_px.size < 50:
        return max(RANGE_STEP_PX, width // 8)
    return int(np.ceil(4 * float(np.quantile(matched_px, 0.9995)) + 4))


def halve(image: Image) -> Image:
    """Return the grey image at half its size (rounded up), each pixel the mean of four; an odd border is doubled."""
    height, width = image.shape
    if height % 2 or width % 2:
        image = np.asarray(cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE))
    size = ((width + 1) // 2, (height + 1) // 2)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _match_grey(left: Image, right: Image, max_disparity_px: int, window: int) -> FloatMap:
    """Match grey images; the left border gets values too, as far as the right view reaches."""
    count = RANGE_STEP_PX * max(1, -(-(max_disparity_px + 1) // RANGE_STEP_PX))
    area = window * window
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=window,
        P1=PENALTY_SMALL * area,
        P2=PENALTY_LARGE * area,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=UNIQUE_PERCENT,
        speckleWindowSize=round(left.size * SPECKLE_SHARE),
        speckleRange=SPECKLE_STEP_PX,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # OpenCV leaves the first `count` columns out; padding gives them back.
    pad = (0, 0, count, 0, cv2.BORDER_REPLICATE)
    codes = matcher.compute(cv2.copyMakeBorder(left, *pad), cv2.copyMakeBorder(right, *pad))[:, count:]
    disparity_px = unlock(np.asarray(codes, dtype=np.int16))
    disparity_px[disparity_px > np.arange(left.shape[1], dtype=np.float32)] = 0  # the right view does not reach there
    return disparity_px


def unlock(codes: npt.NDArray[np.int16]) -> FloatMap:
    """Turn the matcher's sixteenths of a pixel into disparities, px, and undo two of its habits; below 0 becomes 0.

    It rounds fractions below a whole pixel up, those above to the nearest: the former are a sixteenth too large. And a
    parabola through costs that are flat near a whole pixel (Birchfield-Tomasi's are) is drawn to it, by up to a quarter
    of a pixel on known shifts: f + sin(2 pi f) / (2 pi), the strongest such wave that keeps disparities in order, takes
    most of that back.
    """
    code = np.arange(max(0, int(codes.max())) + 1)
    part = code % 16
    exact_px = (code - (part > 8) - 0.5 * (part == 8)) / 16  # a half may be either
    table = (exact_px + np.sin(2 * np.pi * exact_px) / (2 * np.pi)).astype(np.float32)
    return np.take(table, np.maximum(codes, 0))
