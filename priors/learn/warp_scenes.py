"""Disparities for single real images, plausible ones, prepared once to disk: warp.py makes pairs of them.

- KITTI odometry: what semi-global matching found, smoothed, filled and with sharp edges; or a teacher's map.
- KITTI raw training drive: LiDAR, completed.
- CamVid: a layout made of its labels: road and pavement are a plane, walls stand where they meet it, cars, people and
  poles where they touch it.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import read_image
from priors.drives.kitti_raw import KittiRaw
from priors.learn.pair_file import read_left, read_matched, write_image
from priors.learn.pseudo_labels import CALM_PX, find_sky
from priors.learn.teacher_maps import find_map, is_fresh, offset, read_map
from priors.learn.warp import DisparityImage, fill_nearest, sharpen
from priors.pairs.smoothing import diffuse
from priors.sky import sky_mask
from priors.types import FloatMap, Image, Mask

CAMVID, SLOW_NAME = "camvid", "slow"
"""What the names of CamVid's and of the training drive's files begin with."""
SLOW = "kitti_raw_train/2011_09_26/2011_09_26_drive_sfnd_sync"
REACH = 721.54 * 0.54
"""Focal length x baseline by which the LiDAR's depth becomes disparity, px m."""
LARGER = 1.5
"""CamVid's frames are small: they are enlarged by this."""
SKY, BUILDING, POLE, ROAD, PAVEMENT, TREE, SIGN, FENCE = range(8)
VOID = 11
STANDING = (POLE, SIGN, 8, 9, 10)
"""Poles, signs, cars, pedestrians, cyclists."""
SMALLEST_PX = 24
"""Pieces of fewer pixels are part of what is around them."""


def make_scenes(data: Path, labels: Sequence[Path], out: Path, teacher: Path | None = None) -> list[Path]:
    """Write a scene for each real training image into out, once; return the files in order.

    Args:
        data: folder that holds kitti_raw_train and camvid, or one of them.
        labels: files of labelled odometry views, see pseudo_labels.label_drives.
        out: folder for the scenes.
        teacher: folder of a teacher's maps of the odometry views.
    """
    return [*_odometry(labels, out, teacher), *_slow(data, out), *_camvid(data, out)]


def from_match(left: Image, matched_px: FloatMap, teacher_px: FloatMap | None = None) -> DisparityImage:
    """Make a scene of a real pair's left view (h, w) and what was matched (h, w), px, 0 = none."""
    smooth_px, _ = diffuse(matched_px, left)
    if teacher_px is not None:
        calm = (matched_px > 0) & (np.abs(matched_px - smooth_px) < CALM_PX)
        smooth_px = np.maximum(teacher_px - offset(teacher_px, smooth_px, calm), np.float32(0.1))
    sky = find_sky(left, matched_px)[0]
    return DisparityImage(left, np.where(sky, np.float32(0), sharpen(smooth_px)), sky)


def from_lidar(image: Image, depth_m: FloatMap) -> DisparityImage:
    """Make a scene of an image and its completed depth (h, w), metres, 0 = none."""
    sky = sky_mask(image) & (depth_m == 0)
    disparity_px = np.where(depth_m > 0, np.float32(REACH) / np.maximum(depth_m, np.float32(0.5)), np.float32(0))
    disparity_px = sharpen(fill_nearest(disparity_px, depth_m > 0))
    return DisparityImage(image, np.where(sky, np.float32(0), disparity_px), sky)


def lay_out(labels: npt.NDArray[np.uint8], rng: np.random.Generator) -> FloatMap:
    """Invent disparities (h, w), px, for a street scene of which each pixel's CamVid label is known."""
    height, width = labels.shape
    rows = np.nonzero((labels == ROAD) | (labels == PAVEMENT))[0]
    horizon = (float(np.quantile(rows, 0.003)) if len(rows) else 0.45 * height) - 0.02 * height
    bottom_px = rng.uniform(0.06, 0.15) * width

    def ground(row: npt.NDArray[np.floating] | float) -> FloatMap:
        return np.maximum(bottom_px * (np.asarray(row) - horizon) / (height - horizon), 1.0).astype(np.float32)

    row_of = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], labels.shape)
    disparity_px = np.array(ground(row_of))
    known = np.isin(labels, (SKY, ROAD, PAVEMENT))
    disparity_px[labels == SKY] = 0
    for wall in (BUILDING, TREE, FENCE):
        mask = labels == wall
        base = np.where(mask, row_of, np.float32(0)).max(axis=0)
        base = fill_nearest(base[None], (base > 0)[None])[0]
        smooth = np.asarray(cv2.blur(_median(base, 61)[None], (31, 1)))[0]
        disparity_px[mask] = np.broadcast_to(ground(smooth), labels.shape)[mask]
        known |= mask
    for thing in STANDING:
        count, pieces, boxes, _ = cv2.connectedComponentsWithStats((labels == thing).astype(np.uint8))
        for piece in range(1, count):
            x, y, wide, tall, area = boxes[piece]
            if area < SMALLEST_PX:
                continue
            foot = y + tall - 1
            hangs = foot < horizon + 0.03 * height
            box = slice(y, y + tall), slice(x, x + wide)
            inside = pieces[box] == piece
            place_px = np.exp(rng.uniform(np.log(3), np.log(0.5 * bottom_px))) if hangs else ground(foot)
            disparity_px[box][inside] = place_px
            known[box] |= inside
    return fill_nearest(disparity_px, known)


def _odometry(labels: Sequence[Path], out: Path, teacher: Path | None) -> list[Path]:
    paths = [out / path.name for path in labels]
    for labelled, path in zip(labels, paths, strict=True):
        map_ = find_map(teacher, path.stem)
        if not is_fresh(path, map_):
            image = read_left(labelled)
            taught = None if map_ is None else read_map(map_, image.shape)
            write_image(path, from_match(image, read_matched(labelled), taught))
    return paths


def _slow(data: Path, out: Path) -> list[Path]:
    from priors.methods.completion import Completion

    if not (data / SLOW).is_dir():
        return []
    drive = KittiRaw(data / SLOW)
    paths = [out / f"{SLOW_NAME}_{id_}.npz" for id_ in drive.ids]
    for index, path in enumerate(paths):
        if not path.exists():
            frame = drive[index]
            write_image(path, from_lidar(frame.image(), Completion(source="lidar")(frame).depth_m))
    return paths


def _camvid(data: Path, out: Path) -> list[Path]:
    paths = []
    for number, file in enumerate(sorted((data / CAMVID / "train").glob("*.jpg"))):
        path = out / f"{CAMVID}_{file.stem}.npz"
        paths.append(path)
        if path.exists():
            continue
        image, labels = read_image(file), read_image(data / CAMVID / "trainannot" / f"{file.stem}.png")
        size = round(LARGER * image.shape[1]), round(LARGER * image.shape[0])
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
        labels = np.asarray(cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        sky: Mask = np.asarray(labels == SKY)
        write_image(path, DisparityImage(image, lay_out(labels, np.random.default_rng([number, 31])), sky))
    return paths


def _median(values: FloatMap, window: int) -> FloatMap:
    padded = np.pad(values, window // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1).astype(np.float32)
