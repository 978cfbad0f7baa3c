"""Rows of the table: a network's depth brought to known depth, and its confidence brought to a probability."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from priors.errors import DataError
from priors.methods._mono_align import fit
from priors.nets.confidence import ConfidenceCalibration, is_hidden
from priors.stress.inputs import EMPTY, Given
from priors.stress.routine import FLOAT32_ONLY, NO_BFLOAT, NO_MASK, NO_POSES, Case, Outputs, Routine

COUNT = 240
SCALE = 1.7


def mono_alignment(space: Literal["depth", "disparity"]) -> Callable[[Given], Case]:
    """Return the case of a line through a network's values, a fifth of which are extreme and say nothing."""

    def case(given: Given) -> Case:
        size = given.size(COUNT)
        values, known_m = given.plain(1, 40, size), np.zeros(size)
        shift = 0.0 if given.size(2) == (1,) or np.ptp(values) == 0 else (1.5 if space == "depth" else 0.01)
        line = SCALE * values + shift
        known_m = line if space == "depth" else 1 / line
        wrong = (given.random.random(size) < 0.2) & (np.arange(np.prod(size)).reshape(size) > 0)
        values = np.where(wrong | (given.input is EMPTY), given.values(1, 40, size), values)
        kind: Literal["scale", "scale-shift"] = "scale-shift" if shift else "scale"

        def found() -> Outputs:
            settled = fit(given.precision.array(values), known_m.astype(np.float32), kind, space)
            return {"scale": settled.scale, "shift": settled.shift}

        nothing = DataError if given.input is EMPTY else None
        size_of_shift = abs(shift) if shift else 1.0
        return Case(found, lambda: {"scale": SCALE, "shift": shift}, {"shift": size_of_shift}, raises=nothing)

    return case


def calibrated_confidence(given: Given) -> Case:
    """Look scores up in a falling table."""
    size = given.size(16, 20)
    scores = given.values(0.05, 9, size, signed=True)
    knots = np.sort(given.random.uniform(-8, 8, 20)).astype(np.float32)
    heights = np.linspace(0.99, 0.02, 20).astype(np.float32)
    table = ConfidenceCalibration((1.0, 0, 0, 0, 0), tuple(map(float, knots)), tuple(map(float, heights)))
    ours = given.precision.array(scores)

    def wanted() -> Outputs:
        chance = np.interp(scores, knots.astype(np.float64), heights.astype(np.float64))
        return {"probability": np.where(np.isnan(scores), np.nan, chance)}

    slope = float(np.max(np.abs(np.diff(heights)) / np.diff(knots)))
    scale = {"probability": max(1.0, slope)}
    return Case(lambda: {"probability": table.probability(ours)}, wanted, scale, spreads=True)


def hidden_pixels(given: Given) -> Case:
    """Tell which pixels the other view cannot see."""
    size = given.size(8, 24)
    disparity_px = given.values(0.5, 12, size)
    disparity_px = np.where(np.isnan(disparity_px), 0, disparity_px)
    ours = given.precision.array(disparity_px)

    def wanted() -> Outputs:
        hidden = np.zeros(size)
        lands = (np.arange(size[1], dtype=np.float32) - ours.astype(np.float32)).astype(np.float64)
        for row, column in np.ndindex(*size):
            nearest = lands[row, column + 1 :].min(initial=np.inf)
            hidden[row, column] = lands[row, column] < 0 or nearest <= lands[row, column] - 0.5
        return {"hidden": hidden}

    return Case(lambda: {"hidden": is_hidden(ours)}, wanted)


ROUTINES = (
    Routine("mono alignment in depth", "priors/methods/_mono_align.py", mono_alignment("depth"), NO_POSES, NO_BFLOAT),
    Routine(
        "mono alignment in disparity", "priors/methods/_mono_align.py", mono_alignment("disparity"), NO_POSES, NO_BFLOAT
    ),
    Routine(
        "calibrated confidence",
        "priors/nets/confidence.py",
        calibrated_confidence,
        {**NO_POSES, **NO_MASK},
        FLOAT32_ONLY,
    ),
    Routine("hidden pixels", "priors/nets/confidence.py", hidden_pixels, {**NO_POSES, **NO_MASK}, FLOAT32_ONLY),
)
