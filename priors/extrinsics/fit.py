"""The fit of turn, delay and place to what surfaces show, with standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.extrinsics.belief import AHEAD_M, PRIOR, UNKNOWNS, Belief
from priors.extrinsics.correction import Correction
from priors.extrinsics.surfaces import COLUMNS, DELAY, MISMATCH_PX, RECTIFICATION, TURN, SurfaceView
from priors.pairs.rectification import EXPECTED_SPREAD, NOISE_PX, RectificationError

Floats = npt.NDArray[np.float64]

ROUNDS = 24
FINEST_PX, COARSEST_PX, FALL = 0.15, 2.0, 0.75
"""Scale of Cauchy's weights at the end and at the beginning; how it falls from round to round."""
BIAS_PX, BIAS_AT_M = 0.1, 10.0
"""A match that is so far off sees a surface there nearer or farther: its bias looks like a LiDAR that stands ahead."""
HOLD_PX = 20.0
"""Noise of one residual beside the spread that is expected of the pair's rectification: the residuals of a frame share
what the match does wrong, and a turn is likelier than a pair that is off."""
YAW_PX = 0.25
"""Error of yaw that more frames do not lower (standard deviation), in the images that are matched."""
FEWEST = 500
"""Points in all frames."""
SCALES = np.array([*np.degrees(np.ones(3)), 1, 1, 1, 1])
"""From the columns' units, with angles in radians, to those of UNKNOWNS."""


@dataclass(frozen=True)
class Fit:
    """What surfaces say."""

    belief: Belief
    rectification: RectificationError


class _Sums(NamedTuple):
    """Normal equations of the frames."""

    H: Floats
    """(frames, COLUMNS, COLUMNS)."""
    g: Floats
    """(frames, COLUMNS)."""
    compared: int
    """Points that were compared."""


def fit_surfaces(views: Sequence[SurfaceView]) -> Fit | None:
    """Fit turn, delay and place of the LiDAR, and the pair's rectification, to what surfaces show.

    Reweighted least squares (Cauchy's weights). The place and the rectification have priors: they are not far off. A
    delay is fitted where the car's motion is known in some frame.

    Returns:
        the fit; None where few points are compared.
    """
    if not views:
        return None
    columns = [n for n in range(COLUMNS) if n != DELAY or any(view.points.rate_m_s.any() for view in views)]
    usual = np.zeros(COLUMNS)
    usual[RECTIFICATION] = *views[0].usual.offset_px, views[0].usual.scale - 1
    values = usual.copy()
    bias_m = BIAS_PX * BIAS_AT_M**2 / views[0].fx_baseline
    ridge = np.diag(_stiffness(bias_m)[columns])
    for number in range(ROUNDS):
        sums = _sum(views, values, max(FINEST_PX, COARSEST_PX * FALL**number))
        if sums.compared < FEWEST:
            return None
        H = sums.H.sum(axis=0)[np.ix_(columns, columns)] + ridge
        values[columns] += np.linalg.solve(H, sums.g.sum(axis=0)[columns] - ridge @ (values - usual)[columns])
    covariance = np.diag(np.square([*np.ones(TURN.start), *(PRIOR / SCALES)]))
    covariance[np.ix_(columns, columns)] = _covariance(sums, H, columns)
    belief = Belief(values[TURN.start :] * SCALES, covariance[TURN.start :, TURN.start :] * np.outer(SCALES, SCALES))
    belief = belief.less_sure("yaw", float(np.degrees(YAW_PX / views[0].camera.fx)))
    return Fit(_unbiased(belief, bias_m), _rectification(values))


def _sum(views: Sequence[SurfaceView], values: Floats, scale_px: float) -> _Sums:
    """Compare all views and sum up their normal equations."""
    parts_H, parts_g, count = [], [], 0
    for view in views:
        mismatch_px = MISMATCH_PX * (2 if scale_px > 1 else 1)
        factors, residual_px = view.compare(_correction(values), _rectification(values), mismatch_px)
        weighted = factors / (1 + np.square(residual_px / scale_px))[:, None]
        parts_H.append(weighted.T @ factors)
        parts_g.append(weighted.T @ residual_px)
        count += len(residual_px)
    return _Sums(np.array(parts_H), np.array(parts_g), count)


def _covariance(sums: _Sums, H: Floats, columns: list[int]) -> Floats:
    """Return the covariance of the columns that are fitted.

    It joins that of an M-estimator (Huber 1967), frames being independent of each other, and what neighbouring points
    of a frame have in common (NOISE_PX).
    """
    inverse = np.linalg.inv(H)
    g = sums.g[:, columns] - sums.g[:, columns].mean(axis=0)
    frames = len(g)
    return np.asarray(inverse @ (g.T @ g * frames / max(1, frames - 1)) @ inverse + inverse * NOISE_PX**2)


def _stiffness(bias_m: float) -> Floats:
    """Return how firmly each column (COLUMNS,) is held at what is usual: the noise over the spread, squared."""
    spread = PRIOR / SCALES
    spread[-1] = np.hypot(spread[-1], bias_m)
    pair = HOLD_PX / np.array(EXPECTED_SPREAD)[: RECTIFICATION.stop]
    return np.square(np.concatenate([pair, NOISE_PX / spread]))


def _unbiased(belief: Belief, bias_m: float) -> Belief:
    """Return the belief in which "ahead" is the LiDAR's place alone: what was fitted is that and the match's bias."""
    share = AHEAD_M**2 / (AHEAD_M**2 + bias_m**2)
    part = np.diag([*np.ones(len(UNKNOWNS) - 1), share])
    covariance = part @ belief.covariance @ part
    covariance[-1, -1] += share * bias_m**2
    return Belief(part @ belief.mean, covariance)


def _correction(values: Floats) -> Correction:
    return Belief(values[TURN.start :] * SCALES, np.zeros((0, 0))).correction


def _rectification(values: Floats) -> RectificationError:
    shift, tilt, yaw, pitch, stretch = values[RECTIFICATION].tolist()
    return RectificationError(shift, tilt, yaw, pitch, 1 + stretch)
