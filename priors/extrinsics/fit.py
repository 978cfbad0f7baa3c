"""The fit of turn, delay and place to what surfaces show, with standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.extrinsics.correction import NONE, Correction
from priors.extrinsics.surfaces import COLUMNS, DELAY, MISMATCH_PX, PLACE, RECTIFICATION, TURN, SurfaceView
from priors.pairs.rectification import EXPECTED_SPREAD, NOISE_PX, RectificationError

Floats = npt.NDArray[np.float64]

UNKNOWNS = ("pitch", "yaw", "roll", "delay", "aside", "down", "ahead")
"""Of the LiDAR, in the order of the columns from TURN on."""
ROUNDS, ROUNDS_NEAR = 24, 8
FINEST_PX, COARSEST_PX, NEAR_PX, FALL = 0.15, 2.0, 0.5, 0.75
"""Scale of Cauchy's weights at the end, at the beginning, and where the start is near; how it falls from round to
round."""
PLACE_M = 0.01
"""How well a calibration knows where the LiDAR is, sideways and upwards (standard deviation), metres."""
BIAS_PX, BIAS_AT_M = 0.1, 10.0
"""Forward it is known as well as a match that is so far off sees a surface there: its bias looks the same."""
HOLD_PX = 20.0
"""Noise of one residual beside the spread that is expected of the pair's rectification: the residuals of a frame share
what the match does wrong, and a turn is likelier than a pair that is off."""
FEWEST = 500
"""Points in all frames."""


@dataclass(frozen=True)
class Held:
    """What is not fitted beside the rest, and how well it is known (standard deviations)."""

    yaw_deg: float = 0.0
    delay_s: float = 0.0
    aside_m: float = PLACE_M


@dataclass(frozen=True)
class Fit:
    """What surfaces say."""

    correction: Correction
    errors: Floats
    """(len(UNKNOWNS),) standard errors of pitch, yaw and roll, degrees, of the delay, seconds, and of the place,
    metres; inf where held."""
    yaw_by_aside: float
    """How many degrees yaw would be fitted more for each metre that the LiDAR is taken to stand farther to the right;
    0 where yaw is held."""
    rectification: RectificationError


class _Sums(NamedTuple):
    """Normal equations of the frames."""

    H: Floats
    """(frames, COLUMNS, COLUMNS)."""
    g: Floats
    """(frames, COLUMNS)."""
    compared: int
    """Points that were compared."""


def fit_surfaces(
    views: Sequence[SurfaceView], start: Correction, free: Sequence[str] = UNKNOWNS[:4], held: Held = Held()
) -> Fit | None:
    """Fit what is free of turn and delay, the LiDAR's height and how far it is ahead, and the pair's rectification.

    Reweighted least squares (Cauchy's weights). The place and the rectification have priors: they are not far off.

    Args:
        views: of several frames.
        start: what it starts from: nothing, or what is near already; what is not free stays so. How far the LiDAR is
            aside is not fitted: edges tell.
        free: unknowns among turn and delay.
        held: how well the rest is known: the errors of what is fitted hold that.

    Returns:
        the fit; None where few points are compared.
    """
    if not views:
        return None
    columns = [*range(TURN.start), *(TURN.start + UNKNOWNS.index(name) for name in (*free, "down", "ahead"))]
    usual = np.zeros(COLUMNS)
    usual[RECTIFICATION] = *views[0].usual.offset_px, views[0].usual.scale - 1
    values = usual.copy()
    values[TURN], values[DELAY], values[PLACE] = np.radians(start.turn_deg), start.delay_s, start.moved_m
    ridge = np.diag(_stiffness(views[0])[columns])
    rounds, coarsest_px = (ROUNDS, COARSEST_PX) if start == NONE else (ROUNDS_NEAR, NEAR_PX)
    for number in range(rounds):
        sums = _sum(views, values, max(FINEST_PX, coarsest_px * FALL**number))
        if sums.compared < FEWEST:
            return None
        H = sums.H.sum(axis=0)[np.ix_(columns, columns)] + ridge
        values[columns] += np.linalg.solve(H, sums.g.sum(axis=0)[columns] - ridge @ (values - usual)[columns])
    errors, by_aside = _errors(sums, H, columns, held)
    errors[: TURN.stop - TURN.start] = np.degrees(errors[: TURN.stop - TURN.start])
    return Fit(_correction(values), errors, by_aside, _rectification(values))


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


def _errors(sums: _Sums, H: Floats, columns: list[int], held: Held) -> tuple[Floats, float]:
    """Return the standard errors (len(UNKNOWNS),), inf where held, radians, and Fit.yaw_by_aside.

    They join those of an M-estimator (Huber 1967), frames being independent of each other; what neighbouring points of
    a frame have in common (NOISE_PX); and what is held ("consider" covariance, Schmidt 1966).
    """
    inverse = np.linalg.inv(H)
    g = sums.g[:, columns] - sums.g[:, columns].mean(axis=0)
    frames = len(g)
    covariance = inverse @ (g.T @ g * frames / max(1, frames - 1)) @ inverse + inverse * NOISE_PX**2
    yaw = TURN.start + UNKNOWNS.index("yaw")
    considered = {PLACE.start: held.aside_m, yaw: np.radians(held.yaw_deg), DELAY: held.delay_s}
    considered = {column: error for column, error in considered.items() if column not in columns}
    moved = inverse @ sums.H.sum(axis=0)[np.ix_(columns, list(considered))]
    covariance += (moved * np.square(list(considered.values()))) @ moved.T
    errors = np.full(COLUMNS, np.inf)
    errors[columns] = np.sqrt(np.maximum(0, np.diag(covariance)))
    by_aside = -float(np.degrees(moved[columns.index(yaw), 0])) if yaw in columns else 0.0
    return errors[TURN.start :], by_aside


def _stiffness(view: SurfaceView) -> Floats:
    """Return how firmly each column (COLUMNS,) is held at what is usual: the noise over the spread, squared."""
    stiff = np.zeros(COLUMNS)
    stiff[RECTIFICATION] = np.square(HOLD_PX / np.array(EXPECTED_SPREAD)[: RECTIFICATION.stop])
    ahead_m = BIAS_PX * BIAS_AT_M**2 / view.fx_baseline
    stiff[PLACE] = np.square(NOISE_PX / np.array([PLACE_M, PLACE_M, ahead_m]))
    return stiff


def _correction(values: Floats) -> Correction:
    pitch, yaw, roll = np.degrees(values[TURN]).tolist()
    right, down, forward = values[PLACE].tolist()
    return Correction((pitch, yaw, roll), float(values[DELAY]), (right, down, forward))


def _rectification(values: Floats) -> RectificationError:
    shift, tilt, yaw, pitch, stretch = values[RECTIFICATION].tolist()
    return RectificationError(shift, tilt, yaw, pitch, 1 + stretch)
