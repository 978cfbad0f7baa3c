"""Poses: are they there, rigid, unbroken, and do they move as a camera does?"""

from collections.abc import Iterator, Sequence

import numpy as np

from priors.check.axes import judge_axes, judge_direction
from priors.check.finding import Finding, some
from priors.check.sample import Sample
from priors.motion import FASTEST_M_S, Trajectory
from priors.types import Frame

STILL_M = 0.02
FAR_M = 10_000.0
"""Beyond, it is noted that the poses are far from the origin."""
STEPS_M = (10.0, 1.0, 0.5, 0.25, 0.125, 0.1, 0.0625, 0.03125)
"""Poses far from the origin whose positions are multiples of one of these were written with too few digits."""


def judge_poses(frames: Sequence[Frame], sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Judge the poses of all frames, and what the sampled frames' images show of the motion."""
    refused = [frame for frame in frames if frame.T_world_cam is None and "pose" in frame.missing]
    if refused:
        first = refused[0].missing["pose"]
        yield Finding("fatal", "poses", f"{len(refused)} frames have none, the first {refused[0].id}: {first}")
    path = Trajectory.of_frames(frames)
    if len(path.T_world_rig) < 2:
        if not refused:
            text = "no poses: sweeps cannot be accumulated, radiance fields cannot be fitted"
            yield Finding("note", "poses", text)
        return
    if len(path.names) + len(refused) < len(frames):
        lacking = [frame.id for frame in frames if frame.T_world_cam is None and "pose" not in frame.missing]
        yield Finding("warning", "poses", f"{len(lacking)} frames have none: {some(lacking)}")
    yield from _rigid(path)
    yield from _motion(path)
    if not (yield from judge_axes(sampled)):
        yield from judge_direction(path, pair=frames[0].baseline_m is not None)


def _rigid(path: Trajectory) -> Iterator[Finding]:
    """Find poses whose 3x3 part is no rotation."""
    R = path.T_world_rig[:, :3, :3]
    skewed = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 1e-3
    skewed |= np.linalg.det(R) < 0
    if skewed.any():
        ids = [path.names[n] for n in np.flatnonzero(skewed).tolist()]
        yield Finding("fatal", "poses", f"{len(ids)} are no rigid motions: {some(ids)}: their 3x3 part is no rotation")


def _motion(path: Trajectory) -> Iterator[Finding]:
    """Speed, jumps, stand-still, and where in the world."""
    steps_m, usual = path.steps_m, float(np.median(path.speeds_m_s))
    text = f"{len(path.names)} poses, {steps_m.sum():.1f} m, median {usual:.1f} m/s"
    if path.breaks.any():
        yield Finding("warning", "poses", f"{text}; {_jumps(path)}")
    elif usual > FASTEST_M_S:
        yield Finding("warning", "poses", f"{text}: no car is so fast: are they metres, and are the times right?")
    else:
        yield Finding("ok", "poses", text)
    still = np.count_nonzero(steps_m < STILL_M)
    if still:
        many = f"{still} of {len(steps_m)} steps"
        yield Finding("note", "poses", f"the vehicle stands still in {many}: leave them out with --min-motion 0.1")
    far_m = float(np.linalg.norm(path.T_world_rig[:, :3, 3], axis=1).max())
    if far_m <= FAR_M:
        return
    yield Finding("note", "poses", f"they lie {far_m / 1000:.0f} km from the origin: fine, what counts is relative")
    lattice_m = lattice(path)
    if lattice_m is not None:
        text = f"positions are multiples of {lattice_m:g} m: they were rounded: write them with more digits"
        yield Finding("warning", "poses", text)


def _jumps(path: Trajectory) -> str:
    """Say how many steps break the path, which is the largest, and what is used."""
    breaks = np.flatnonzero(path.breaks)
    moved = int(breaks[np.argmax(path.steps_m[breaks])])
    turned = int(breaks[np.argmax(path.turns_rad[breaks])])
    if path.steps_m[moved] > 2 * np.median(path.steps_m):
        what = f"{path.names[moved]} to {path.names[moved + 1]} moves {path.steps_m[moved]:.1f} m"
    else:
        degrees = np.degrees(path.turns_rad[turned])
        what = f"{path.names[turned]} to {path.names[turned + 1]} turns {degrees:.0f} degrees"
    return f"{len(breaks)} jumps, the largest: {what}"


def lattice(path: Trajectory) -> float | None:
    """Return the step, metres, on whose multiples the positions lie along one of the axes; None where there is none.

    It is that of float32 far from the origin (a power of two) or of few digits (a power of ten), the largest that fits.
    """
    for step_m in STEPS_M:
        for along_m in path.T_world_rig[:, :3, 3].T:
            moves = np.ptp(along_m) > step_m and np.abs(along_m).max() > FAR_M
            if moves and np.abs(along_m / step_m - np.rint(along_m / step_m)).max() < 1e-3:
                return step_m
    return None
