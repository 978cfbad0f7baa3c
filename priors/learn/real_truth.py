"""Real frames with truth: KITTI 2015 (disparity, cars are CAD models) and drive 0009 (accumulated sweeps).

    frames = RealTruth(Path("../shared/data")).frames["kitti2015"]

What is held back (priors/held_back.py) is never among the training frames. Both kinds have the pair and a sweep. For
stereo networks `label` makes a training pair of a frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from priors.codecs import as_grey
from priors.drives.kitti_raw import KittiRaw
from priors.drives.kitti_stereo import KittiStereo
from priors.geometry import convert_disparity
from priors.held_back import is_held_back, training_frames
from priors.learn import pair_file
from priors.learn.pseudo_labels import CALM_PX, find_sky
from priors.learn.stereo_pair import StereoPair
from priors.methods.lidar import Lidar
from priors.pairs.matching import match
from priors.pairs.read import read_pair
from priors.pairs.rectification import RectificationError, compare, fit, row_slope, usual_error
from priors.pairs.smoothing import diffuse
from priors.types import Camera, FloatMap, Frame, Mask

KITTI2015, DRIVE = "kitti2015", "drive0009"
"""Names of the sources."""
PAIRS = Path("kitti_stereo2015/training")
RAW = Path("kitti_raw_train/2011_09_26/2011_09_26_drive_0009_sync")
SURE = 0.05
"""Least confidence of an accumulated value to be truth."""
MATCHED = 0.2
"""Weight of a calm match where there is no truth: above the scanner's reach there is nothing else."""
CONTRADICTED_PX, CONTRADICTED = 3.0, 0.1
"""An accumulated value this far from a calm match, and by that share, is no truth: a thing that moved, or an edge."""


@dataclass(frozen=True)
class RealTruth:
    """The real frames with truth below a folder; any of them may be missing."""

    folder: Path
    """Holds kitti_stereo2015, kitti_raw_train or both."""

    @cached_property
    def frames(self) -> dict[str, list[Frame]]:
        """The frames to train on, by source; a source that is not there is left out."""
        pairs, drive = self._pairs, self._drive
        found = {} if pairs is None else {KITTI2015: training_frames(pairs)}
        return found if drive is None else found | {DRIVE: training_frames(drive)}

    @cached_property
    def held_back(self) -> list[Frame]:
        """The KITTI 2015 frames that are held back: their truth is official."""
        pairs = self._pairs
        if pairs is None:
            return []
        return [pairs[at] for at, id_ in enumerate(pairs.ids) if is_held_back(pairs.name, id_)]

    @cached_property
    def _pairs(self) -> KittiStereo | None:
        folder = self.folder / PAIRS
        return KittiStereo(folder, "image_2") if folder.is_dir() else None

    @cached_property
    def _drive(self) -> KittiRaw | None:
        folder = self.folder / RAW
        return KittiRaw(folder) if folder.is_dir() else None


def truth_m(frame: Frame) -> FloatMap:
    """Return a frame's truth (height, width), metres, 0 = none: its own map, else its accumulated sweeps."""
    if frame.has("truth"):
        return frame.truth().depth_m
    accumulated = Lidar()(frame)
    if accumulated.confidence is None:
        raise ValueError("the lidar method gives a confidence with every map")
    return np.where(accumulated.confidence > SURE, accumulated.depth_m, np.float32(0))


def label(frame: Frame, source: str) -> StereoPair:
    """Return a frame's pair, labelled by its truth, as the images have it."""
    return label_with_error(frame, source)[0]


def label_with_error(frame: Frame, source: str) -> tuple[StereoPair, RectificationError]:
    """Return a frame's pair, labelled by its truth as the images have it, and the error between both.

    Truth is what the calibration promises, and the images are off by their rectification error. A network that learned
    the difference would correct for one rig, unseen. So the error is fitted to a match of this pair and taken off.
    Where there is no truth a calm match is a label of less weight, and the sky is the sky.
    """
    if frame.baseline_m is None:
        raise ValueError(f"frame {frame.id}: truth of a pair without a baseline")
    pair = read_pair(frame)
    true_px = convert_disparity(truth_m(frame), frame.camera.fx, frame.baseline_m)
    matched_px = match(pair.left, pair.right)
    smooth_px, _ = diffuse(matched_px, as_grey(pair.left))
    calm = (matched_px > 0) & (np.abs(matched_px - smooth_px) < CALM_PX)
    error = fit(compare(frame.camera, true_px, matched_px, row_slope(smooth_px)), usual_error(frame.rig, frame.camera))
    value_px = as_matched(true_px, error, frame.camera)
    if not frame.has("truth"):
        value_px[_contradicts(value_px, smooth_px, calm)] = 0
    known = value_px > 0
    sky, open_ = find_sky(pair.left, matched_px)
    sky &= ~known
    weight = np.where(known | sky, 1.0, np.where(calm & ~open_, MATCHED, 0.0)).astype(np.float32)
    value_px = np.where(known, value_px, np.where(sky | (weight == 0), np.float32(0), smooth_px))
    return StereoPair(pair.left, pair.right, value_px.astype(np.float32), sky, weight, source), error


def as_matched(true_px: FloatMap, error: RectificationError, camera: Camera) -> FloatMap:
    """Return the disparity (height, width), px, 0 = none, that a matcher sees where the truth is true_px."""
    added_px = error.correct(np.zeros_like(true_px), camera)
    seen_px = (true_px - added_px) / np.float32(error.scale)
    return np.where((true_px > 0) & (seen_px > 0), seen_px, np.float32(0)).astype(np.float32)


def label_frames(folder: Path, out: Path) -> dict[str, list[Path]]:
    """Label every training frame below a folder into out, once; returns the files by source, in order."""
    return {source: list(_labelled(frames, source, out)) for source, frames in RealTruth(folder).frames.items()}


def label_held_back(folder: Path, out: Path) -> list[Path]:
    """Label the KITTI 2015 frames that are held back into out, once; returns the files, in order."""
    return list(_labelled(RealTruth(folder).held_back, KITTI2015, out))


def _labelled(frames: list[Frame], source: str, out: Path) -> Iterator[Path]:
    for frame in frames:
        path = out / f"{source}_{frame.id}.npz"
        if not path.exists():
            pair_file.write(path, label(frame, source))
        yield path


def _contradicts(value_px: FloatMap, smooth_px: FloatMap, calm: Mask) -> Mask:
    off_px = np.abs(value_px - smooth_px)
    return np.asarray(calm & (off_px > CONTRADICTED_PX) & (off_px > CONTRADICTED * smooth_px))
