"""Labels of sky without a human: what LiDAR and matching say is a surface, and what networks are sure of elsewhere.

The labellers are networks that learned from the labelled images alone. LiDAR and matching know no walls from clouds by
their looks: where they see something near, a bright wall is a wall, whatever the networks say.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from priors import drives
from priors.codecs import as_grey
from priors.drives import DriveOptions
from priors.learn.pseudo_labels import reaching_far
from priors.learn.real_truth import RealTruth
from priors.learn.sky_labels import REST, SKY, UNKNOWN, SkySample
from priors.methods.lidar import Lidar
from priors.pairs.matching import quick_match
from priors.pairs.read import read_pair
from priors.pairs.smoothing import diffuse
from priors.types import FloatMap, Frame, Image, Mask

NEAR_PX, FAR_PX = 5.0, 3.0
"""A match of a larger disparity is a surface; around one larger than FAR_PX nothing is called sky."""
CALM_PX = 1.5
"""A match may differ so much from those around it."""
TEXTURED, TEXTURE_PX = 5.0, 9
"""Deviation of grey in a window of that side, above which a match is believed: blank skies match anything."""
SURE = 1.5
"""Logit beyond which the labellers are believed where nothing was measured."""
AROUND_PX = 9
"""Side of the window around a match or a point."""
INSIDE_PX = 25
"""Where the labellers see sky, a surface fills a window of that side: a wire's match spreads into the sky."""
LOWEST_SKY = 0.62
"""Below this share of the height there is no sky in front of a car."""
STEPS = {"kitti2015": 1, "drive0009": 3}
"""Every so many frames of a source are taken: neighbours look alike."""
ODOMETRY, ODOMETRY_STEP = ("06", "01"), 8
SLOW, SLOW_STEP = Path("kitti_raw_train/2011_09_26/2011_09_26_drive_sfnd_sync"), 4

Labeller = Callable[[Image], FloatMap]
"""Image to logits of sky (height, width)."""


def read_evidence(data: Path, labeller: Labeller) -> Iterator[SkySample]:
    """Label what training frames there are below a folder."""
    for source, frame in training_frames(data):
        image = frame.image()
        yield SkySample(source, image, label(labeller(image), *measure(frame)))


def training_frames(data: Path) -> Iterator[tuple[str, Frame]]:
    """Give the frames that are labelled so, and their sources."""
    for source, frames in RealTruth(data).frames.items():
        yield from ((source, frame) for frame in frames[:: STEPS[source]])
    for sequence in ODOMETRY if (data / "kitti_odometry").is_dir() else ():
        drive = drives.open_drive(data / "kitti_odometry", options=DriveOptions(drive=sequence))
        yield from ((sequence, drive[at]) for at in range(ODOMETRY_STEP // 2, len(drive), ODOMETRY_STEP))
    if (data / SLOW).is_dir():
        slow = drives.open_drive(data / SLOW)
        yield from (("image_02", slow[at]) for at in range(SLOW_STEP // 2, len(slow), SLOW_STEP))


def measure(frame: Frame) -> tuple[FloatMap, Mask]:
    """Return calm matches (height, width), px, 0 = none, and where the scanner hit something."""
    shape = frame.camera.size
    matched_px, hit = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    if frame.has("other"):
        pair = read_pair(frame)
        found_px = quick_match(pair.left, pair.right)
        smooth_px, _ = diffuse(found_px, as_grey(pair.left))
        calm = (np.abs(found_px - smooth_px) < CALM_PX) & (texture(as_grey(pair.left)) > TEXTURED)
        matched_px = np.where(calm, found_px, np.float32(0))
    if frame.has("sweep"):
        hit = Lidar(sweeps=1)(frame).depth_m > 0
    return matched_px, hit


def texture(grey: Image) -> FloatMap:
    """Return the standard deviation of grey (height, width) around each pixel."""
    values, window = grey.astype(np.float32), (TEXTURE_PX, TEXTURE_PX)
    return np.sqrt(np.maximum(cv2.blur(values * values, window) - cv2.blur(values, window) ** 2, 0))


def label(logit: FloatMap, matched_px: FloatMap, hit: Mask) -> FloatMap:
    """Label an image (height, width): sky, no sky, not known.

    Args:
        logit: of sky, what the labellers say.
        matched_px: disparities of calm matches, 0 = none.
        hit: where the scanner hit something.
    """
    around = np.ones((AROUND_PX, AROUND_PX), np.uint8)
    low = (np.arange(len(logit)) >= LOWEST_SKY * len(logit))[:, None]
    near = (matched_px > NEAR_PX) | (cv2.dilate(hit.astype(np.uint8), around) > 0)
    close = cv2.dilate((matched_px > FAR_PX).astype(np.uint8), around) > 0
    piece = (logit > 0).astype(np.uint8)
    far = reaching_far(piece, matched_px) > 0 if matched_px.any() else piece > 0
    sky = (logit > SURE) & far & ~close & ~near & ~low
    inside = cv2.erode(
        cv2.morphologyEx(near.astype(np.uint8), cv2.MORPH_CLOSE, around), np.ones((INSIDE_PX, INSIDE_PX))
    )
    rest = (near & (logit < 0)) | (inside > 0) | low | (logit < -SURE)
    return np.where(sky, SKY, np.where(rest, REST, UNKNOWN)).astype(np.float32)
