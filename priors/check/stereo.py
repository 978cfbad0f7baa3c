"""Stereo: do the two images show one moment, with the other camera's shifted to the right side, along rows?"""

from collections.abc import Generator, Iterator, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from priors.check.finding import Finding, some
from priors.check.sample import Sample

FEWEST = 30
"""Corners that must be found in the other image."""
OFF_ROW_PX, BAD_ROW_PX = 0.5, 2.0
"""Vertical offset of the pair, median."""
SCATTER_PX = 1.0
"""Deviation from it, median, beyond which the images are of two moments: between them things move across rows."""
SURE_PX = 0.2
"""Where they scatter less, it is one moment."""
SAME_PX = 0.75
"""Where nine in ten corners are shifted less, the two images are one."""
TWIN_LEVELS, BLANK_LEVELS = 0.5, 5.0
"""Grey levels that two files of one image differ by, on average; spread of an image that shows something."""
CALMER = 0.6
"""Another moment's scatter must be so much less to be the right one."""


def judge_stereo(sampled: Sequence[Sample]) -> Generator[Finding, None, bool]:
    """Judge the pairs of the sampled frames; returns whether what they see is evidence for other findings."""
    pairs = [sample for sample in sampled if sample.read("image") is not None and sample.read("other") is not None]
    if not pairs:
        return False
    yield from _kinds(pairs)
    yield from _twins(pairs)
    by_frame = [shifts for sample in pairs if (shifts := sample.corners) is not None]
    if not by_frame:
        yield Finding("warning", "stereo", f"no corner found in {len(pairs)} pairs of images: are they blank?")
        return False
    shifts = np.concatenate(by_frame)
    if len(shifts) < FEWEST:
        text = f"only {len(shifts)} corners of {len(by_frame)} frames found in the other image: is it the same moment?"
        yield Finding("warning", "stereo", text)
        return False
    judged = _judge_shifts(pairs, shifts)
    yield judged
    return judged.level != "fatal" and abs(float(np.median(shifts[:, 1]))) <= BAD_ROW_PX


def _kinds(pairs: Sequence[Sample]) -> Iterator[Finding]:
    """Find pairs whose images differ in size or in kind."""
    for sample in pairs:
        image, other = sample.read("image"), sample.read("other")
        if image.shape[:2] != other.shape[:2]:
            sizes = " and ".join(f"{a.shape[1]}x{a.shape[0]}" for a in (image, other))
            text = f"frame {sample.frame.id}: the two images are {sizes}: expected equal, resize neither"
            yield Finding("fatal", "stereo", text)
            return
    image, other = pairs[0].read("image"), pairs[0].read("other")
    if image.ndim != other.ndim:
        kinds = " and ".join("grey" if a.ndim == 2 else "in colour" for a in (image, other))
        yield Finding("note", "stereo", f"the two images are {kinds}: they are matched in grey")


def _twins(pairs: Sequence[Sample]) -> Iterator[Finding]:
    """Find single frames whose two images are one; where all are, the corners tell."""
    twins = [sample.frame.id for sample in pairs if _is_twin(sample)]
    if 0 < len(twins) < len(pairs):
        yield Finding("fatal", "stereo", f"frames {some(twins)}: left and right are the same image")


def _is_twin(sample: Sample) -> bool:
    """Tell whether a frame's two images are one, and show something."""
    image, other = sample.read("image"), sample.read("other")
    same = image.shape == other.shape and float(np.mean(cv2.absdiff(image, other))) < TWIN_LEVELS
    return bool(same and image.std() > BLANK_LEVELS)


def _judge_shifts(pairs: Sequence[Sample], shifts: npt.NDArray[np.float64]) -> Finding:
    """Judge where corners lie in the other image (n, 2): disparity and vertical offset, px."""
    disparity_px, rows_px = np.median(shifts, axis=0)
    wrong = float(np.mean(shifts[:, 0] < -0.5))
    text = f"median disparity {disparity_px:.1f} px, vertical offset {rows_px:+.2f} px ({len(shifts)} corners)"
    if float(np.quantile(np.abs(shifts[:, 0]), 0.9)) < SAME_PX:
        return Finding("fatal", "stereo", f"{text}: nothing is shifted: are left and right the same images?")
    if wrong > 0.5:
        text += f": {wrong:.0%} are shifted the wrong way: swap left and right images"
        return Finding("fatal", "stereo", text)
    scatter_px = _scatter(shifts)
    moment = _other_moment(pairs, scatter_px) if scatter_px > SURE_PX else None
    if moment is not None or scatter_px > SCATTER_PX:
        cause = moment or "the two images are of two moments"
        return Finding("fatal", "stereo", f"{text}, scattered by {scatter_px:.1f} px: {cause}: join them by frame")
    if abs(rows_px) > BAD_ROW_PX:
        text += ": the rows do not match: stereo shifts them back, nothing else does: rectify the pair anew"
        return Finding("warning", "stereo", text)
    if abs(rows_px) > OFF_ROW_PX or wrong > 0.2:
        return Finding("warning", "stereo", f"{text}, {wrong:.0%} shifted the wrong way: rectified well?")
    return Finding("ok", "stereo", text)


def _scatter(shifts: npt.NDArray[np.float64]) -> float:
    """Return how far corners (n, 2) lie from the median row offset, px, median."""
    return float(np.median(np.abs(shifts[:, 1] - np.median(shifts[:, 1]))))


def _other_moment(pairs: Sequence[Sample], scatter_px: float) -> str | None:
    """Say from which frame the other images are, where that before or after fits better; None where it does not."""
    ways = {"ahead": [sample.before for sample in pairs], "behind": [sample.after for sample in pairs]}
    for way, moments in ways.items():
        by_frame = [sample.corners_in(moment) for sample, moment in zip(pairs, moments, strict=True)]
        found = [shifts for shifts in by_frame if shifts is not None and len(shifts)]
        shifts = np.concatenate(found) if found else np.zeros((0, 2))
        if len(shifts) >= FEWEST and _scatter(shifts) < CALMER * scatter_px:
            return f"the other camera's images are one frame {way}"
    return None
