"""Sky labels: images with labels for training the sky mask, by the place they come from.

CamVid has labels, the street knows its sky; for a few KITTI frames (training drives only) a polygon drawn by hand says
where the sky may be and a rule on brightness which of its pixels are sky.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import read_image
from priors.types import FloatMap, Image, Mask

SKY, REST, UNKNOWN = 1.0, 0.0, -1.0
CAMVID_SKY, CAMVID_VOID = 0, 11


@dataclass(frozen=True)
class SkySample:
    """An image and what is sky in it."""

    place: str
    """Sequence it comes from: the rule must work where it has not been, so places are held out whole."""
    image: Image
    """RGB or grey."""
    label: FloatMap
    """(height, width): 1 sky, 0 not, -1 not known."""


@dataclass(frozen=True)
class Outline:
    """Where the sky may be in a KITTI frame, drawn by hand."""

    path: str
    """Below the data folder."""
    polygon: tuple[tuple[int, int], ...]
    """(x, y), pixels."""
    brighter_than: int | None
    """The darkest colour channel of sky; None: sky is what is close to its neighbourhood's commonest grey."""


def _box(right: int, bottom: int) -> tuple[tuple[int, int], ...]:
    return (0, 0), (right, 0), (right, bottom), (0, bottom)


_06, _01 = "kitti_odometry/sequences/06/image_0/", "kitti_odometry/sequences/01/image_0/"
_SLOW = "kitti_raw_train/2011_09_26/2011_09_26_drive_sfnd_sync/image_02/data/"
OUTLINES = (
    Outline(
        _06 + "000000.png",
        (
            *((0, 0), (869, 0), (819, 39), (661, 22), (642, 79), (642, 133), (602, 158), (257, 158)),
            *((247, 39), (153, 39), (153, 109), (133, 99), (59, 44), (0, 69)),
        ),
        None,
    ),
    Outline(
        _06 + "000025.png",
        (
            *((59, 0), (730, 0), (681, 59), (671, 128), (622, 138), (592, 168), (296, 148), (207, 138)),
            (118, 99),
        ),
        None,
    ),
    Outline(
        _06 + "000050.png",
        (
            *((0, 0), (725, 0), (725, 59), (681, 109), (622, 123), (592, 158), (237, 118), (197, 99)),
            *((158, 118), (148, 138), (0, 113)),
        ),
        None,
    ),
    Outline(_01 + "000000.png", _box(1241, 110), 135),
    Outline(_01 + "000012.png", _box(1241, 120), 135),
    Outline(_01 + "000025.png", _box(1241, 120), 135),
    Outline(_01 + "000037.png", _box(1241, 130), 135),
    Outline(_01 + "000050.png", _box(800, 125), 135),
)
SLOW_OUTLINES = (
    (0, ((0, 0), (975, 0), (900, 35), (745, 45), (740, 120), (0, 120))),
    (8, _box(800, 110)),
    (16, _box(760, 110)),
    (25, _box(760, 100)),
)
"""Frame's place in the slow drive and its polygon: overexposed sky, white trucks beside it."""


def of_place(samples: Iterable[SkySample], place: str) -> list[SkySample]:
    """Return a place's samples."""
    return [sample for sample in samples if sample.place == place]


def read_camvid(folder: Path, split: str) -> Iterator[SkySample]:
    """Read CamVid's frames of a split (train, val); the place is the sequence."""
    for path in sorted((folder / split).glob("*.jpg")):
        codes = read_image(folder / f"{split}annot" / f"{path.stem}.png")
        label = np.where(codes == CAMVID_SKY, SKY, np.where(codes == CAMVID_VOID, UNKNOWN, REST))
        yield SkySample(path.stem[:4], read_image(path), label.astype(np.float32))


def read_street(folder: Path, step: int = 3) -> Iterator[SkySample]:
    """Read every step-th frame of a street that `priors street` wrote."""
    for mask in sorted(folder.glob("**/sky/image_02/data/*.png"))[::step]:
        image = mask.parents[3] / "image_02" / "data" / mask.name
        yield SkySample("street", read_image(image), (read_image(mask) > 127).astype(np.float32))


def read_kitti(data: Path) -> Iterator[SkySample]:
    """Read the outlined KITTI frames."""
    slow = sorted((data / _SLOW).iterdir())
    boxes = [Outline(str(slow[n].relative_to(data)), polygon, 225) for n, polygon in SLOW_OUTLINES]
    for outline in (*OUTLINES, *boxes):
        image = read_image(data / outline.path)
        yield SkySample(Path(outline.path).parents[1].name, image, label_outline(image, outline))


def label_outline(image: Image, outline: Outline) -> FloatMap:
    """Label a frame from its outline: sky, not sky, and a band between them that is left open."""
    inside = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(inside, [np.array(outline.polygon, np.int32)], 1)
    near = cv2.dilate(inside, np.ones((9, 9), np.uint8)) > 0
    if outline.brighter_than is None:
        off = np.abs(cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32) - _commonest(image, inside > 0))
        sky, open_ = off < 14, off < 25
    else:
        darkest = (image if image.ndim == 2 else image.min(axis=2)).astype(np.float32)
        sky, open_ = darkest > outline.brighter_than, darkest > 0.6 * outline.brighter_than
        # Below the box bright things are sky between leaves, or a car's roof, or wet road.
        below = np.zeros_like(inside)
        below[:190, : max(x for x, _ in outline.polygon)] = 1
        near |= open_ & (below > 0)
    sky = (inside > 0) & sky
    unknown = near & (open_ | (inside == 0)) & ~sky
    return np.where(sky, SKY, np.where(unknown, UNKNOWN, REST)).astype(np.float32)


def _commonest(grey: Image, inside: Mask) -> FloatMap:
    """Return the commonest even grey inside the polygon around each tile of 60 x 12 pixels; 0 where there is none."""
    edge = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    usable: npt.NDArray[np.bool_] = inside & (edge < 40) & (grey > 55)
    out = np.zeros(grey.shape, np.float32)
    for y in range(0, 180, 12):
        for x in range(0, grey.shape[1], 60):
            window = slice(y, y + 12), slice(max(0, x - 60), x + 120)
            values = grey[window][usable[window]]
            if values.size > 150:
                smooth = np.convolve(np.bincount(values, minlength=256), np.ones(7), "same")
                out[y : y + 12, x : x + 60] = smooth.argmax()
    return out
