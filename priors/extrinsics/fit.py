"""The fit of turn and delay to what surfaces show, with standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.extrinsics.correction import Correction
from priors.extrinsics.surfaces import COLUMNS, DELAY, MISMATCH_PX, PLACE, RECTIFICATION, TURN, SurfaceView
from priors.pairs.rectification import EXPECTED_SPREAD, NOISE_PX, RectificationError

Floats = npt.NDArray[np.float64]

UNKNOWNS = ("pitch", "yaw", "roll", "delay")
ROUNDS = 24
FINEST_PX, COARSEST_PX, FALL = 0.15, 2.0, 0.75
"""Scale of Cauchy's weights at the end and the beginning, and how it falls from round to round."""
PLACE_M = 0.01
"""How well it is known where the LiDAR is, sideways and upwards (standard deviation), metres: it is not fitted, but
told in the errors."""
BIAS_PX, BIAS_AT_M = 0.1, 10.0
"""Forward it is known as well as a match that is so far off sees a surface there: its bias looks the same."""
HOLD_PX = 20.0
"""Noise of one residual beside the spread that is expected of the pair's rectification: the residuals of a frame share
what the match does wrong, and a turn is likelier than a pair that is off."""
FEWEST = 500
"""Points in all frames."""


@dataclass(frozen=True)
class Fit:
    """What surfaces say."""

    correction: Correction
    errors: Floats
    """(4,) standard errors of pitch, yaw and roll, degrees, and of the delay, seconds; inf where held."""
    rectification: RectificationError


class _Sums(NamedTuple):
    """Normal equations of the frames."""

    H: Floats
    """(frames, COLUMNS, COLUMNS)."""
    g: Floats
    """(frames, COLUMNS)."""
    compared: int
    """Points that were compared."""


def fit_surfaces(views: Sequence[SurfaceView], start: Correction, free: Sequence[str] = UNKNOWNS) -> Fit | None:
    """Fit what is free of turn and delay, and the pair's rectification, by reweighted least squares (Cauchy's weights).

    Args:
        views: of several frames.
        start: what it starts from; what is not free stays so.
        free: unknowns.

    Returns:
        the fit; None where few points are compared.
    """
    columns = [
        *range(RECTIFICATION.stop),
        *(TURN.start + ["pitch", "yaw", "roll", "delay"].index(name) for name in free),
    ]
    values = np.zeros(COLUMNS)
    values[TURN], values[DELAY] = np.radians(start.turn_deg), start.delay_s
    if not views:
        return None
    usual = np.zeros(COLUMNS)
    usual[RECTIFICATION] = *views[0].usual.offset_px, views[0].usual.scale - 1
    values[RECTIFICATION] = usual[RECTIFICATION]
    ridge = np.diag((HOLD_PX / _expected())[columns] ** 2)
    for number in range(ROUNDS):
        sums = _sum(views, values, max(FINEST_PX, COARSEST_PX * FALL**number))
        if sums.compared < FEWEST:
            return None
        H = sums.H.sum(axis=0)[np.ix_(columns, columns)] + ridge
        values[columns] += np.linalg.solve(H, sums.g.sum(axis=0)[columns] - ridge @ (values - usual)[columns])
    errors = np.full(COLUMNS, np.inf)
    errors[columns] = _errors(sums, H, columns, BIAS_PX * BIAS_AT_M**2 / views[0].fx_baseline)
    return Fit(_correction(values), np.array([*np.degrees(errors[TURN]), errors[DELAY]]), _rectification(values))


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


def _errors(sums: _Sums, H: Floats, columns: list[int], forward_m: float) -> Floats:
    """Return the standard errors of the columns.

    They join those of an M-estimator (Huber 1967), frames being independent of each other; what neighbouring points of
    a frame have in common (NOISE_PX); and the LiDAR's place, which is not fitted: it is known within PLACE_M, and ahead
    within forward_m ("consider" covariance, Schmidt 1966).
    """
    inverse = np.linalg.inv(H)
    g = sums.g[:, columns] - sums.g[:, columns].mean(axis=0)
    frames = len(g)
    covariance = inverse @ (g.T @ g * frames / max(1, frames - 1)) @ inverse + inverse * NOISE_PX**2
    moved = inverse @ sums.H.sum(axis=0)[columns, PLACE]
    covariance += (moved * np.square([PLACE_M, PLACE_M, forward_m])) @ moved.T
    return np.sqrt(np.maximum(0, np.diag(covariance)))


def _expected() -> Floats:
    """Return how far each column is expected to lie from 0 (standard deviation)."""
    spread = np.full(COLUMNS, np.inf)
    spread[RECTIFICATION] = np.array(EXPECTED_SPREAD)[: RECTIFICATION.stop]
    return spread


def _correction(values: Floats) -> Correction:
    pitch, yaw, roll = np.degrees(values[TURN]).tolist()
    return Correction((pitch, yaw, roll), float(values[DELAY]))


def _rectification(values: Floats) -> RectificationError:
    shift, tilt, yaw, pitch, stretch = values[RECTIFICATION].tolist()
    return RectificationError(shift, tilt, yaw, pitch, 1 + stretch)
