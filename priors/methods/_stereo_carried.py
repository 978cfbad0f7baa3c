"""A frame's stereo map carried on from the frame before: moved by the poses, checked against the frame's own pair.

The check is a match of the pair at half size, an eighth of the whole work. Where it agrees, the carried value stays,
which is finer. Where it differs - what moved, what came into view - the match is taken, smoothed and filled.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import expit

from priors.codecs import as_grey
from priors.geometry import invert
from priors.methods import _stereo_classical as classical
from priors.pairs.matching import half_match, halve
from priors.pairs.read import Pair
from priors.pairs.rectification import RectificationError
from priors.pairs.smoothing import diffuse
from priors.recalibration import CLASSICAL_STEREO, Recalibration, log_odds
from priors.types import Depth, Earlier, FloatMap, Frame, Mask, Matrix

AGREE_PX, AGREE_SHARE = 2.0, 0.03
"""A carried and a matched disparity that differ by less, px or as a share, are of one surface. Half a pixel of the half
size is 1 px, and a match that runs one way lags by 0.4 px on a road."""
LEAST_AGREEMENT = 0.5
"""Where a smaller share of the compared pixels agrees, poses or scene are not what they should be: nothing is kept."""
LEAST_SEEN = 0.3
"""Where fewer of the carried pixels can be compared, the check says too little."""
OUTLINE_WINDOW, OUTLINE_PX = 5, 3.0
"""A pixel lies beside an outline where the disparities in a window about it, pixels, differ by more."""
MORE_SURE = (-0.35, -0.2, 0.2)
MORE_SURE_BESIDE_OUTLINE = (-1.4, -0.8, 0.0)
"""Log-odds, of values that were filled in, were kept unseen, and were confirmed: how much oftener they are within 1 m
than they say, on drive 0009 and a street. A kept one says so again in each frame of a chain."""
FARTHEST_MOVE_M, LARGEST_TURN_RAD = 5.0, 0.2
"""Beyond such a step too little is seen in both frames, or the path breaks there."""


@dataclass(frozen=True)
class Merged:
    """A carried map where the pair confirms it, and the pair's own match elsewhere; (height, width), as `Pair.left`."""

    disparity_px: FloatMap
    """Corrected; 0 = none."""
    confirmed: Mask
    """Where the carried value and the match agree."""
    kept: Mask
    """Where the carried value stays: confirmed, or nothing was matched there."""
    evidence: FloatMap
    """Share of matches in what was averaged, [0, 1]."""

    @property
    def more_sure(self) -> FloatMap:
        """What the log-odds of a value's confidence change by (height, width)."""
        window = np.ones((OUTLINE_WINDOW, OUTLINE_WINDOW), np.uint8)
        spread_px = cv2.morphologyEx(self.disparity_px.astype(np.float32), cv2.MORPH_GRADIENT, window)
        more_sure = np.array([MORE_SURE, MORE_SURE_BESIDE_OUTLINE], np.float32)
        beside_outline = (spread_px > OUTLINE_PX).astype(np.uint8)
        return np.asarray(more_sure[beside_outline, self.kept.astype(np.uint8) + self.confirmed])


def carry_on(frame: Frame, pair: Pair, before: Earlier, error: RectificationError, fx_baseline: float) -> Depth | None:
    """Return a frame's map made of the frame's before; None where it must be made whole.

    Args:
        frame: the frame.
        pair: its pair, rows matching.
        before: the frame before and its map.
        error: what matched disparities are corrected by.
        fx_baseline: focal length times baseline, px m.
    """
    T_now_before = motion(frame, before.frame)
    if T_now_before is None or before.depth.confidence is None:
        return None
    carried_px, trust = _moved(before.depth, T_now_before, frame.camera.K, fx_baseline)
    merged = merge(frame, pair, pair.restore(carried_px), error)
    if merged is None:
        return None
    stated = classical.probability(merged.disparity_px, _expected_error(merged.evidence), fx_baseline)
    fresh = Recalibration.of(CLASSICAL_STEREO).own(stated)
    trust = pair.restore(trust)
    trust = np.where(merged.confirmed, trust, np.where(merged.kept, np.minimum(trust, fresh), fresh))
    trust = expit(log_odds(trust) + merged.more_sure)
    has_value = merged.disparity_px > 0
    depth_m = np.where(has_value, np.float32(fx_baseline) / np.where(has_value, merged.disparity_px, 1), 0)
    return Depth(*(pair.restore(part.astype(np.float32)) for part in (depth_m, np.where(has_value, trust, 0))))


def motion(frame: Frame, before: Frame) -> Matrix | None:
    """Return T_now_before (4, 4), metres; None without poses, between unlike cameras, and at too large a step."""
    alike = frame.camera.size == before.camera.size and np.array_equal(frame.camera.K, before.camera.K)
    if frame.T_world_cam is None or before.T_world_cam is None or not alike:
        return None
    T_now_before: Matrix = invert(frame.T_world_cam) @ before.T_world_cam
    turn_rad = np.arccos(np.clip((np.trace(T_now_before[:3, :3]) - 1) / 2, -1, 1))
    near = np.linalg.norm(T_now_before[:3, 3]) <= FARTHEST_MOVE_M and turn_rad <= LARGEST_TURN_RAD
    return T_now_before if near else None


def merge(frame: Frame, pair: Pair, carried_px: FloatMap, error: RectificationError) -> Merged | None:
    """Check a carried map (height, width), px, against the pair; None where too little of it can be kept."""
    there = carried_px > 0
    if not there.any():
        return None
    height, width = carried_px.shape
    most_px = min(width - 1, int(np.quantile(carried_px[there][::7], 0.9995)) + 8)
    small_left = halve(as_grey(pair.left))
    small_px = half_match(pair.left, pair.right, most_px)
    matched_px = 2 * _doubled(small_px, (height, width), cv2.INTER_NEAREST)
    seen = matched_px > 0
    matched_px = np.where(seen, pair.restore(error.correct(pair.restore(matched_px), frame.camera)), 0)
    compared = seen & there
    confirmed = compared & (np.abs(matched_px - carried_px) <= np.maximum(AGREE_PX, AGREE_SHARE * carried_px))
    count, compared_count = int(confirmed.sum()), int(compared.sum())
    if compared_count < LEAST_SEEN * int(there.sum()) or count < LEAST_AGREEMENT * compared_count:
        return None
    sparse_px = np.where(confirmed, carried_px, matched_px).astype(np.float32)
    small_px, evidence = diffuse(np.ascontiguousarray(0.5 * sparse_px[::2, ::2]), small_left)
    filled_px = 2 * _doubled(small_px, (height, width), cv2.INTER_LINEAR)
    kept = confirmed | (there & ~seen)
    merged_px = np.where(kept, carried_px, filled_px)
    return Merged(merged_px, confirmed, kept, _doubled(evidence, (height, width), cv2.INTER_NEAREST))


def _moved(depth: Depth, T_now_before: Matrix, K: Matrix, fx_baseline: float) -> tuple[FloatMap, FloatMap]:
    """Return disparity, px, and confidence of a map as the frame now sees it; 0 where nothing is seen."""
    from priors.kernels.carry import carry

    disparity_px = np.where(depth.valid, np.float32(fx_baseline) / np.where(depth.valid, depth.depth_m, 1), 0)
    moved: tuple[FloatMap, FloatMap] = carry(
        disparity_px.astype(np.float32), depth.trust(), np.ascontiguousarray(T_now_before), K, float(fx_baseline)
    )
    return moved


def _expected_error(evidence: FloatMap) -> FloatMap:
    """Return the error to expect of a filled disparity, px: what classical stereo expects where matches scatter."""
    most = classical.ERROR_PX + classical.ERROR_UNMATCHED_PX + classical.ERROR_PER_ROUGHNESS
    return np.float32(most) - np.float32(classical.ERROR_UNMATCHED_PX) * evidence


def _doubled(small: FloatMap, size: tuple[int, int], how: int) -> FloatMap:
    """Return a map of half the size, rounded up, at its full size (height, width); values stay what they are."""
    twice = (2 * small.shape[1], 2 * small.shape[0])
    return np.asarray(cv2.resize(small, twice, interpolation=how)[: size[0], : size[1]], dtype=np.float32)
