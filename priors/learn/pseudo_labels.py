"""Pseudo-labels for real pairs without truth: disparities that two matchers agree on, or that one is sure of.

The classical matcher labels every pair. A teacher's maps (see teacher_labels.py) add to them. A network that was
trained on KITTI's truth has learned that truth's rectification: LiDAR and images disagree by up to 1 px at the image's
sides. So what differs smoothly between the two matchers is taken off the teacher, pair by pair. What is left must agree
with the classical match; where there is none, both views must show the same.
"""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.learn import pair_file
from priors.learn.eye_views import RIGHT, read_views, sequences
from priors.learn.stereo_pair import StereoPair
from priors.learn.teacher_maps import find_map, is_fresh, offset, read_map
from priors.pairs.matching import match
from priors.pairs.smoothing import diffuse
from priors.sky import sky_mask
from priors.types import FloatMap, Image, Mask

CALM_PX = 0.5
"""A match this close to the smoothed map is no mismatch."""
AGREE_PX = 1.0
"""Teacher and match that differ by less than this agree."""
ALONE, TAUGHT, BOTH = 0.5, 0.4, 0.9
"""Weight of a match without a teacher, of a teacher without a match, of both."""
EDGE_PX = 1.0
"""A teacher's maps are blurred where neighbours differ by more."""
SKY_MARGIN_PX = 9
SKY_PX = 4.0
"""Sky is not where something is matched nearer than this."""
HORIZON_PX, HORIZON_SHARE = 8.0, 0.1
"""Sky reaches down to far things: a bright wall has none farther than this along that share of its outline."""
SAME, SAME_GREY = 0.5, 3.0
"""Both views show the same where they differ by less than this share of the contrast around, and these levels."""
BLANK_GREY, BLANK_ROWS = 5.0, 0.45
"""What has less contrast than this, in that upper share of the image, may be sky: a teacher does not know."""


def label_drives(data: Path, out: Path, teacher: Path | None = None) -> list[Path]:
    """Label every odometry pair below data into out, once; a pair is labelled anew when its teacher's map is newer.

    Args:
        data: folder that holds kitti_odometry.
        out: folder for one .npz a view.
        teacher: folder of the teacher's maps, `06_000002.npy` or `06_000002_right.npy`, a prefix allowed.

    Returns:
        The files, in order.
    """
    paths = []
    for sequence in sequences(data):
        stems = sorted(path.stem for path in (sequence / "image_0").iterdir())
        names = [f"{sequence.name}_{stem}{side}" for stem in stems for side in ("", RIGHT)]
        if not all(is_fresh(out / f"{name}.npz", find_map(teacher, name)) for name in names):
            for view in read_views(sequence):
                path, map_ = out / f"{view.name}.npz", find_map(teacher, view.name)
                if not is_fresh(path, map_):
                    matched_px = match(view.left, view.right)
                    taught = None if map_ is None else read_map(map_, view.left.shape)
                    pair_file.write(path, label(view.left, view.right, matched_px, taught), matched_px)
        paths += [out / f"{name}.npz" for name in names]
    return paths


def label(left: Image, right: Image, matched_px: FloatMap, teacher_px: FloatMap | None = None) -> StereoPair:
    """Label a pair (h, w) by what was matched (h, w), px, 0 = none, and a teacher's disparities, if there are any."""
    grey, grey_right = as_grey(left), as_grey(right)
    smooth_px, _ = diffuse(matched_px, grey)
    calm = (matched_px > 0) & (np.abs(matched_px - smooth_px) < CALM_PX)
    sky, open_ = find_sky(left, matched_px)
    if teacher_px is None:
        value_px, weight = smooth_px, ALONE * calm
    else:
        teacher_px = np.maximum(teacher_px - offset(teacher_px, smooth_px, calm), np.float32(0))
        agree = calm & (np.abs(teacher_px - smooth_px) < AGREE_PX)
        clear = ~steep(teacher_px) & same(grey, grey_right, teacher_px) & (matched_px == 0)
        value_px = np.where(agree, (teacher_px + smooth_px) / 2, teacher_px)
        weight = np.where(agree, BOTH, TAUGHT * clear)
    weight = np.where(sky, 1.0, np.where(open_, 0.0, weight)).astype(np.float32)
    value_px = np.where(sky | (weight == 0), np.float32(0), value_px).astype(np.float32)
    return StereoPair(left, right, value_px, sky, weight, "odometry")


def find_sky(image: Image, matched_px: FloatMap) -> tuple[Mask, Mask]:
    """Return where there surely is sky (h, w), and where there may be some."""
    window = np.ones((SKY_MARGIN_PX, SKY_MARGIN_PX), np.uint8)
    mask = reaching_far(sky_mask(image).astype(np.uint8), matched_px)
    matched = cv2.dilate((matched_px > SKY_PX).astype(np.uint8), window) > 0
    # The image's own edge is no edge of the sky.
    inside = cv2.erode(mask, window, borderType=cv2.BORDER_CONSTANT, borderValue=1) > 0
    return inside & ~matched, (cv2.dilate(mask, window) > 0) & (matched_px <= SKY_PX)


def reaching_far(mask: npt.NDArray[np.uint8], matched_px: FloatMap) -> npt.NDArray[np.uint8]:
    """Keep the pieces of the mask (h, w) along whose outline something far is matched."""
    count, pieces, boxes, _ = cv2.connectedComponentsWithStats(mask)
    reaching = np.zeros_like(mask)
    reach = SKY_MARGIN_PX
    for piece in range(1, count):
        x, y, width, height, _ = boxes[piece]
        box = slice(max(0, y - reach), y + height + reach), slice(max(0, x - reach), x + width + reach)
        inside = (pieces[box] == piece).astype(np.uint8)
        ring = (cv2.dilate(inside, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > inside) & (matched_px[box] > 0)
        around_px = matched_px[box][ring]
        if around_px.size and np.quantile(around_px, HORIZON_SHARE) < HORIZON_PX:
            reaching[box] |= inside
    return reaching


def steep(map_: FloatMap) -> Mask:
    """Tell where neighbours differ by more than EDGE_PX (h, w)."""
    window = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(map_, window) - cv2.erode(map_, window) > 2 * EDGE_PX)


def same(grey: Image, other: Image, disparity_px: FloatMap) -> Mask:
    """Tell where the other view shows the same (h, w): seen by both, and alike up to brightness."""
    from priors.kernels.disparity_warp import see_right

    height, width = disparity_px.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    there = columns - disparity_px
    warped = cv2.remap(other, there, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    first, second = (_level(image) for image in (grey, np.asarray(warped, np.uint8)))
    contrast = np.sqrt(cv2.blur(first * first, (7, 7)))
    alike = cv2.blur(np.abs(first - second), (7, 7)) < SAME * contrast + SAME_GREY
    _, seen_px = see_right(disparity_px, 0.8)
    column = np.clip(np.rint(there), 0, width - 1).astype(np.intp)
    front = seen_px[np.arange(height)[:, None], column] <= disparity_px + AGREE_PX
    blank = (contrast < BLANK_GREY) & (rows < BLANK_ROWS * height)
    return np.asarray(alike & front & (there >= 0) & ~blank)


def _level(image: Image) -> FloatMap:
    values = image.astype(np.float32)
    return np.asarray(values - cv2.blur(values, (15, 15)), np.float32)
