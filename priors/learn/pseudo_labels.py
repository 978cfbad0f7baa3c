"""Labels for real pairs without truth: what two matchers agree on, or one is sure of.

The classical matcher labels every pair. A teacher's maps (`python -m priors.learn.teacher_labels`) add to them: a network that
was trained on KITTI's truth has learned that truth's rectification (up to 1 px at the image's sides, where LiDAR and
images disagree), so what differs smoothly between the two matchers is taken off the teacher, pair by pair. What is left
must agree with the classical match, or where there is none, show the same in both views.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.drives.kitti_odometry import KittiOdometry
from priors.errors import DataError
from priors.learn.stereo_pair import Pair
from priors.pairs.matching import match, to_grey
from priors.pairs.smoothing import diffuse
from priors.sky import sky_mask
from priors.types import FloatMap, Image, Mask

PER_PX = 256
CALM_PX = 0.5
"""A match this close to the smoothed map is no mismatch."""
AGREE_PX = 1.0
OFFSET_PX = 3.0
"""Largest difference of teacher and match that says something about the offset between them."""
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
Side = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class View:
    """One eye's view of a real pair; the right eye's is mirrored, so that it too is the left one of its pair."""

    sequence: str
    frame_id: str
    side: Side
    left: Image
    right: Image

    @property
    def name(self) -> str:
        """Return what files about this view are called."""
        return f"{self.sequence}_{self.frame_id}" + ("_right" if self.side == "right" else "")


def sequences(data: Path) -> list[Path]:
    """List the sequences of a KITTI odometry folder."""
    return sorted(path.parent for path in (data / "kitti_odometry" / "sequences").glob("*/calib.txt"))


def read_views(sequence: Path, camera: str = "image_0") -> Iterator[View]:
    """Read the pairs of a sequence, each as either eye sees it."""
    drive = KittiOdometry(sequence, camera)
    for index in range(len(drive)):
        frame = drive[index]
        left, right = frame.image(), frame.other()
        yield View(sequence.name, frame.id, "left", left, right)
        yield View(sequence.name, frame.id, "right", *(np.ascontiguousarray(a[:, ::-1]) for a in (right, left)))


def prepare(data: Path, out: Path, teacher: Path | None = None) -> list[Path]:
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
        names = [f"{sequence.name}_{stem}{side}" for stem in stems for side in ("", "_right")]
        if not all(fresh(out / f"{name}.npz", find(teacher, name)) for name in names):
            for view in read_views(sequence):
                path, map_ = out / f"{view.name}.npz", find(teacher, view.name)
                if not fresh(path, map_):
                    matched_px = match(view.left, view.right)
                    taught = None if map_ is None else read_map(map_, view.left.shape)
                    write(path, label(view.left, view.right, matched_px, taught), matched_px)
        paths += [out / f"{name}.npz" for name in names]
    return paths


def read_map(path: Path, size: tuple[int, ...]) -> FloatMap:
    """Read a teacher's map (h, w), px, of a view; that of a right eye is stored unmirrored, and turned here."""
    map_ = np.load(path, allow_pickle=False).astype(np.float32)
    if map_.shape != size:
        raise DataError(f"{path}: a disparity map {map_.shape}, the image is {size}: teach again")
    return np.ascontiguousarray(map_[:, ::-1]) if path.stem.endswith("_right") else map_


def label(left: Image, right: Image, matched_px: FloatMap, teacher_px: FloatMap | None = None) -> Pair:
    """Label a pair (h, w) by what was matched (h, w), px, 0 = none, and a teacher's disparities, if there are any."""
    grey, grey_right = to_grey(left), to_grey(right)
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
    return Pair(left, right, value_px, weight > 0, sky, weight, "odometry")


def find_sky(image: Image, matched_px: FloatMap) -> tuple[Mask, Mask]:
    """Return where there surely is sky (h, w), and where there may be some."""
    window = np.ones((SKY_MARGIN_PX, SKY_MARGIN_PX), np.uint8)
    mask = _reaching_far(sky_mask(image).astype(np.uint8), matched_px)
    matched = cv2.dilate((matched_px > SKY_PX).astype(np.uint8), window) > 0
    # The image's own edge is no edge of the sky.
    inside = cv2.erode(mask, window, borderType=cv2.BORDER_CONSTANT, borderValue=1) > 0
    return inside & ~matched, (cv2.dilate(mask, window) > 0) & (matched_px <= SKY_PX)


def _reaching_far(mask: npt.NDArray[np.uint8], matched_px: FloatMap) -> npt.NDArray[np.uint8]:
    """Keep the pieces of the mask (h, w) along whose outline something far is matched."""
    count, pieces, boxes, _ = cv2.connectedComponentsWithStats(mask)
    kept = np.zeros_like(mask)
    reach = SKY_MARGIN_PX
    for piece in range(1, count):
        x, y, width, height, _ = boxes[piece]
        box = slice(max(0, y - reach), y + height + reach), slice(max(0, x - reach), x + width + reach)
        inside = (pieces[box] == piece).astype(np.uint8)
        ring = (cv2.dilate(inside, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > inside) & (matched_px[box] > 0)
        around_px = matched_px[box][ring]
        if around_px.size and np.quantile(around_px, HORIZON_SHARE) < HORIZON_PX:
            kept[box] |= inside
    return kept


def offset(teacher_px: FloatMap, matched_px: FloatMap, calm: Mask) -> FloatMap:
    """Return how far the teacher is off (h, w), px: a smooth function of place and disparity; 0 without evidence."""
    height, width = teacher_px.shape
    difference = teacher_px - matched_px
    y, x = np.nonzero(calm & (np.abs(difference) < OFFSET_PX))
    y, x = y[::11], x[::11]
    if len(y) < 500:
        return np.zeros_like(teacher_px)

    def terms(y: np.ndarray, x: np.ndarray, px: FloatMap) -> list[np.ndarray]:
        X, Y, D = 2 * x / width - 1, 2 * y / height - 1, px / 50
        return [np.ones_like(X), X, X * X, Y, D, X * D]

    A, b = np.stack(terms(y, x, teacher_px[y, x]), axis=1), difference[y, x]
    fit = np.linalg.lstsq(A, b, rcond=None)[0]
    near = np.abs(b - A @ fit) < AGREE_PX
    fit = np.linalg.lstsq(A[near], b[near], rcond=None)[0]
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    off = sum(factor * term for factor, term in zip(fit, terms(rows, columns, teacher_px), strict=True))
    return np.asarray(off, np.float32)


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


def write(path: Path, pair: Pair, matched_px: FloatMap) -> None:
    """Write a labelled pair, and what was matched, to one .npz file, atomically."""
    maps: dict[str, np.ndarray] = {
        "matched": np.rint(matched_px * PER_PX).astype(np.uint16),
        "left": pair.left,
        "right": pair.right,
        "disparity": np.rint(pair.disparity_px * PER_PX).astype(np.uint16),
        "weight": np.rint(pair.weight * 255).astype(np.uint8),
        "sky": pair.sky,
    }
    codecs.write_atomically(path, lambda target: _save(target, maps))


def read(path: Path) -> Pair:
    """Read a labelled pair."""
    with np.load(path) as file:
        weight = (file["weight"] / np.float32(255)).astype(np.float32)
        disparity_px = (file["disparity"] / np.float32(PER_PX)).astype(np.float32)
        return Pair(file["left"], file["right"], disparity_px, weight > 0, file["sky"], weight, "odometry")


def read_matched(path: Path) -> FloatMap:
    """Read what was matched (h, w), px, 0 = none."""
    with np.load(path) as file:
        return np.asarray(file["matched"] / np.float32(PER_PX), np.float32)


def _save(target: Path, maps: dict[str, np.ndarray]) -> None:
    with target.open("wb") as file:
        np.savez(file, allow_pickle=False, **maps)


def _level(image: Image) -> FloatMap:
    values = image.astype(np.float32)
    return np.asarray(values - cv2.blur(values, (15, 15)), np.float32)


def find(teacher: Path | None, name: str) -> Path | None:
    """Find a teacher's map of a view, whatever precedes its name."""
    found = [] if teacher is None else sorted(teacher.glob(f"*{name}.npy"))
    return found[0] if found else None


def fresh(path: Path, map_: Path | None) -> bool:
    """Tell whether what was made of a view, with a teacher's map or without, is there and not outdated."""
    return path.exists() and (map_ is None or map_.stat().st_mtime < path.stat().st_mtime)
