"""Skips: what a drive lets us leave out, and how much it is.

Each is a fact of the drive or of its cache, with a number: frames that are cached, or in which the camera stands;
rows that are sky alone, and disparities that no surface reaches, which stereo leaves out of each pair.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from priors import cache
from priors.errors import DataError
from priors.naming import labels
from priors.pairs.matching import RANGE_STEP_PX
from priors.pairs.read import find_range, read_pair
from priors.plan.way import open_some
from priors.sky import rows_below, sky_mask
from priors.types import Drive, Frame

STILL_M, STILL_RAD = 0.05, 0.01
"""A camera that has moved and turned less than this since the last frame that counts sees nothing new."""
MEASURED = 3
"""Frames on which rows and disparities are measured."""
USUAL_SEARCH = 192 / 1242
"""Disparities that stereo papers search on KITTI, as a share of the image's width."""


@dataclass(frozen=True)
class Skip:
    """Something that need not be computed."""

    what: str
    saves: str
    """How much it is, in words."""
    why: str
    share: float
    """Of the frames, rows or disparities that it is about, in [0, 1]."""


def skips(drive: Drive, indices: Sequence[int], folder: Path, held_out: Collection[int]) -> list[Skip]:
    """List what can be left out of a drive's priors, and of a fit that follows.

    Args:
        drive: the drive.
        indices: of the frames that are asked for.
        folder: the cache.
        held_out: of them, those that a fit holds out: their priors are not read.
    """
    found = _cached(drive, indices, folder)
    found += _still(drive, indices)
    found += _of_images(drive, indices)
    if held_out:
        share = len(held_out) / len(indices)
        found.append(
            Skip("held-out views", _frames(len(held_out)), "a fit reads no prior of what it is scored on", share)
        )
    return found


def still(drive: Drive, indices: Sequence[int]) -> list[int]:
    """Return the indices of the frames in which the camera stands where it stood; of a drive without poses none."""
    found: list[int] = []
    last = None
    for index in indices:
        try:
            pose = drive[index].T_world_cam
        except DataError:
            continue
        if pose is None:
            continue
        if last is not None:
            step = np.linalg.inv(last) @ pose
            turned = np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))
            if np.linalg.norm(step[:3, 3]) < STILL_M and turned < STILL_RAD:
                found.append(index)
                continue
        last = pose
    return found


def _cached(drive: Drive, indices: Sequence[int], folder: Path) -> list[Skip]:
    """Tell of each prior of the drive how many of the frames it has."""
    try:
        priors = [
            prior
            for prior in cache.find(folder / drive.name, lambda error: None)
            if prior.manifest.get("fingerprint") == drive.fingerprint()
        ]
    except DataError:
        return []
    wanted = {drive.ids[index] for index in indices}
    found = []
    for name, prior in zip(labels(priors), priors, strict=True):
        done = len(wanted & set(prior.ids()))
        if done:
            found.append(Skip(f"{name} of cached frames", _frames(done), f"in {prior.folder}", done / len(wanted)))
    return found


def _still(drive: Drive, indices: Sequence[int]) -> list[Skip]:
    found = still(drive, indices)
    if not found:
        return []
    why = f"the camera moved less than {100 * STILL_M:g} cm: --min-motion {STILL_M:g} leaves them out"
    return [Skip("frames that add nothing", _frames(len(found)), why, len(found) / len(indices))]


def _of_images(drive: Drive, indices: Sequence[int]) -> list[Skip]:
    """Measure on a few frames which rows are sky alone, and which disparities no surface reaches."""
    rows, disparities = [], []
    for frame in open_some(drive, indices)[:: max(1, min(len(indices), 9) // MEASURED)]:
        try:
            image = frame.image()
            rows.append(rows_below(sky_mask(image)).start / image.shape[0])
            if frame.has("other") and frame.baseline_m is not None:
                disparities.append(_unreached(frame))
        except DataError:
            continue  # `priors check` tells it
    found = []
    if rows and np.mean(rows) > 0:
        share = float(np.mean(rows))
        found.append(Skip("rows of sky", f"{share:.0%} of a pair's rows", "stereo matches what lies below", share))
    if disparities:
        share, most_px, usual_px = (float(value) for value in np.mean(disparities, axis=0))
        if share > 0:
            saves = f"{share:.0%} of {usual_px:.0f} disparities"
            why = f"no surface has more than {most_px:.0f} px, as a match at a quarter of the size shows"
            found.append(Skip("disparities that no surface reaches", saves, why, share))
    return found


def _unreached(frame: Frame) -> tuple[float, float, float]:
    """Return the share of the usual search that a pair does not need, what it needs and the usual, px."""
    pair = read_pair(frame)
    usual_px = max(RANGE_STEP_PX, round(USUAL_SEARCH * pair.left.shape[1] / RANGE_STEP_PX) * RANGE_STEP_PX)
    needed_px = find_range(frame, pair)
    searched_px = RANGE_STEP_PX * -(-(needed_px + 1) // RANGE_STEP_PX)
    return max(0.0, 1 - searched_px / usual_px), needed_px, usual_px


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"
