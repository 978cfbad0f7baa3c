"""Dead reckoning: a path from velocities, tied to recorded positions over seconds.

Positions from satellites drift and jump, velocities of an inertial unit do not. Their integral has the shape of the
path; the positions tell where it lies, through an offset that changes slowly:

    path = integral of velocity + offset
    offset minimises  sum |position - path|^2 dt + tie^2 sum |d offset / dt|^2 dt

It is the Whittaker smoother of first order (Eilers, "A Perfect Smoother", Analytical Chemistry 2003), over time.
"""

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded

Floats = npt.NDArray[np.float64]

TIE_S = (10.0, 10.0, 2.0)
"""Over which time positions decide: east, north, up. Altitudes drift less than a velocity upwards does. Chosen on drive
0009 by what images see (docs/poses.md)."""
LONGEST_STEP_S = 1.0
"""Velocities farther apart in time say nothing about what lies between."""
OFF, OFF_M_S = 0.2, 0.5
"""Velocities are those of the path where half of the steps differ by less than this share of the speed and this much
more."""


def dead_reckon(positions_m: Floats, velocities_m_s: Floats, times_s: Floats) -> Floats | None:
    """Return the path (n, 3), metres; None where the velocities are not of these positions, or times do not rise.

    Args:
        positions_m: (n, 3) as recorded, metres.
        velocities_m_s: (n, 3) in the same axes; NaN where one is not known: the step is then that of the positions.
        times_s: (n,) of both.
    """
    gaps_s, steps_m = np.diff(times_s), np.diff(positions_m, axis=0)
    if len(times_s) < 2 or not (gaps_s > 0).all():
        return None
    sailed_m = (velocities_m_s[1:] + velocities_m_s[:-1]) / 2 * gaps_s[:, None]
    known = np.isfinite(sailed_m) & (gaps_s <= LONGEST_STEP_S)[:, None]
    if not known.any() or not _agree(np.where(known, sailed_m - steps_m, 0.0), steps_m, gaps_s):
        return None
    integral_m = np.zeros_like(positions_m)
    integral_m[1:] = np.cumsum(np.where(known, sailed_m, steps_m), axis=0)
    offset_m = positions_m - integral_m
    smooth_m = [smooth(offset_m[:, axis], gaps_s, tie_s) for axis, tie_s in enumerate(TIE_S)]
    return integral_m + np.stack(smooth_m, axis=1)


def smooth(values: Floats, gaps_s: Floats, tie_s: float) -> Floats:
    """Return values (n,) without what changes faster than tie_s, seconds; gaps_s (n - 1,) lie between them."""
    shares_s = (np.append(gaps_s, 0) + np.insert(gaps_s, 0, 0)) / 2
    stiffness = tie_s**2 / gaps_s
    bands = np.zeros((2, len(values)))  # the upper form of scipy's banded symmetric matrices
    bands[0, 1:] = -stiffness
    bands[1] = shares_s
    bands[1, 1:] += stiffness
    bands[1, :-1] += stiffness
    return np.asarray(solveh_banded(bands, shares_s * values))


def _agree(off_m: Floats, steps_m: Floats, gaps_s: Floats) -> bool:
    """Tell whether steps by velocity are about those of the positions."""
    off_m_s, speed_m_s = (np.median(np.linalg.norm(step, axis=1) / gaps_s) for step in (off_m, steps_m))
    return bool(off_m_s <= OFF * speed_m_s + OFF_M_S)
