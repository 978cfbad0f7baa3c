"""Axes and unit of poses: does the camera move as its images show?

The motion between two frames, as the images show it, is compared with what the poses say, taken as they are and in the
ways in which people write them wrongly. Without such evidence, a camera that moves along none of its own axes is told.
"""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.check.scale import POSE_FACTORS, name_factor, three_digits
from priors.geometry import invert
from priors.motion import Trajectory
from priors.types import Matrix

FEWEST, FEWEST_FINE = 2, 6
"""Pairs of frames that must show the motion, and that tell two conventions apart by turns alone."""
ASIDE_DEG, TURNED_DEG = 25.0, 2.0
"""How far off direction and turn of a motion may be, medians."""
BETTER = 0.4
"""Another convention must be off by so much less."""
TURN_WEIGHT = 10.0
"""A degree of turn counts as so many of direction."""
LONGER = 1.4
"""Motions that are so many times as long, or as short, are in another unit."""
SCATTER = 0.4
"""Deviation from the median of the lengths' ratio's logarithm, median, beyond which poses are other frames'."""
STILL_M = 0.02
STANDS = 0.01
"""Poses that move less than this share of what is seen stand still."""
FINER, FINER_DEG, MOST = 0.5, 0.1, 0.75
"""Where direction and turn fit, another convention is told if its turns are off by so much less: share, degrees, and in
which share of the motions. Where a world's z points backwards, inverted poses of a car differ by so little."""

Floats = npt.NDArray[np.float64]
Reading: TypeAlias = Callable[[Matrix, Matrix], Matrix]
"""Makes T_next_this, in the camera's own axes, of two frames' poses as they are written."""
# What turns the axes of a camera as other conventions have them into ours (x right, y down, z forward).
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward
VEHICLE = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # x forward, y left, z up
AIRCRAFT = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # x forward, y right, z down


def _as_they_are(this: Matrix, following: Matrix) -> Matrix:
    return invert(following) @ this


def _inverted(this: Matrix, following: Matrix) -> Matrix:
    return following @ invert(this)


def _turned_back(this: Matrix, following: Matrix) -> Matrix:
    return _as_they_are(*(np.block([[T[:3, :3].T, T[:3, 3:]], [T[3:]]]) for T in (this, following)))


def _in_axes(axes: Matrix, reading: Reading) -> Reading:
    return lambda this, following: axes @ reading(this, following) @ axes.T


READINGS: Mapping[str, Reading] = {
    "inverted (world to camera): invert them": _inverted,
    "in OpenGL's axes (y up, z backward): negate the second and third column": _in_axes(OPENGL, _as_they_are),
    "inverted (world to camera) and in OpenGL's axes": _in_axes(OPENGL, _inverted),
    "of axes with x forward, y left, z up (the vehicle's or LiDAR's): multiply by the camera's place on it": _in_axes(
        VEHICLE, _as_they_are
    ),
    "inverted, and of axes with x forward, y left, z up": _in_axes(VEHICLE, _inverted),
    "of axes with x forward, y right, z down": _in_axes(AIRCRAFT, _as_they_are),
    "with their rotations transposed": _turned_back,
    "steps from the frame before: chain them": lambda this, following: invert(following),
}
"""What poses may be, and what to do."""


@dataclass(frozen=True)
class Misfit:
    """How far motions by poses are from those seen, medians over pairs of frames."""

    aside_deg: float
    turned_deg: float
    ratio: float
    """Length by the poses over length seen; 1 where lengths are not seen."""
    scatter: float
    """Of the ratio's logarithm."""
    turns_off_deg: Floats
    """(n,) How far the turn of each motion is off."""

    @property
    def cost(self) -> float:
        """Both angles in one number."""
        return self.aside_deg + TURN_WEIGHT * self.turned_deg

    @property
    def fits(self) -> bool:
        """Whether direction and turn are those seen."""
        return self.aside_deg < ASIDE_DEG and self.turned_deg < TURNED_DEG


def judge_axes(sampled: Sequence[Sample]) -> Generator[Finding, None, bool]:
    """Compare poses with the motion that images show; returns whether there was enough to tell."""
    posed = _posed(sampled)
    if len(posed) < FEWEST:
        return False
    by = next((sample.seen_motion.by for sample in posed if sample.seen_motion and sample.seen_motion.by), None)
    eyes = _eyes(by)
    given = compare(posed, _as_they_are)
    if not given.fits:
        yield Finding("warning", "poses", _name_axes(posed, given, by))
        return True
    text = f"{given.aside_deg:.0f} degrees beside what {eyes}, {given.ratio:.2f} times as far ({len(posed)} motions)"
    finer = _finer(posed, given)
    if finer:
        yield Finding("warning", "poses", f"{text}; their turns fit better if they are {', or '.join(finer)}")
    elif max(given.ratio, 1 / given.ratio) > LONGER:
        yield Finding("warning", "poses", _name_scale(posed, given.ratio, by))
    elif given.scatter > SCATTER:
        yield Finding("warning", "poses", f"{text}, now more, now less: are they of other frames?")
    else:
        yield Finding("ok", "poses", text)
    return True


def _eyes(by: str | None) -> str:
    """Say who sees the motion."""
    return "the images see" if by is None else f"{by} sees"


def compare(posed: Sequence[Sample], reading: Reading) -> Misfit:
    """Return how far the poses of samples, read in one way, are from the motion seen."""
    aside, turned, ratios = [], [], []
    for sample in posed:
        motion, this, after = sample.seen_motion, sample.frame.T_world_cam, sample.after
        if motion is None or this is None or after is None or after.T_world_cam is None:
            raise ValueError("a sample without motion or poses")
        T = reading(this, after.T_world_cam)
        aside.append(_angle(T[:3, 3], motion.T_next_this[:3, 3]))
        turned.append(_turn(T[:3, :3] @ motion.T_next_this[:3, :3].T))
        if motion.by is not None:
            ratios.append(np.linalg.norm(T[:3, 3]) / np.linalg.norm(motion.T_next_this[:3, 3]))
    logs = np.log(np.maximum(ratios, 1e-9)) if ratios else np.zeros(1)
    scatter = float(np.median(np.abs(logs - np.median(logs))))
    aside_deg, turned_deg, ratio = float(np.median(aside)), float(np.median(turned)), float(np.exp(np.median(logs)))
    return Misfit(aside_deg, turned_deg, ratio, scatter, np.array(turned))


def motion_ratio(sampled: Sequence[Sample], by: str) -> float | None:
    """Return how many times as far the poses move as one source of depth sees; None where that is not known."""
    posed = [sample for sample in _posed(sampled) if sample.seen_motion is not None and sample.seen_motion.by == by]
    return compare(posed, _as_they_are).ratio if len(posed) >= FEWEST else None


def _posed(sampled: Sequence[Sample]) -> list[Sample]:
    """Return the samples whose frame and the frame after have poses, and whose images show the motion between."""
    return [
        sample
        for sample in sampled
        if sample.frame.T_world_cam is not None
        and sample.after is not None
        and sample.after.T_world_cam is not None
        and sample.seen_motion is not None
    ]


def _name_axes(posed: Sequence[Sample], given: Misfit, by: str | None) -> str:
    """Say which other way of writing poses fits what the images show."""
    eyes = _eyes(by)
    text = f"the camera moves along none of its own axes: {given.aside_deg:.0f} degrees beside what {eyes}"
    if by is not None and given.ratio < STANDS:
        return f"the poses stand still, and {eyes} the camera move: are they of this drive?"
    if given.aside_deg < ASIDE_DEG:
        text = f"the camera turns by other angles than what {eyes}: {given.turned_deg:.1f} degrees off"
    found = {name: compare(posed, reading) for name, reading in READINGS.items()}
    best = min(found.values(), key=lambda misfit: misfit.cost)
    if not best.fits or best.cost > BETTER * given.cost:
        return f"{text}: are they of this drive and this camera, and joined by frame?"
    names = [name for name, misfit in found.items() if misfit.fits and misfit.cost < best.cost + 3]
    return f"{text}; they fit if they are {', or '.join(names)}"


def _finer(posed: Sequence[Sample], given: Misfit) -> list[str]:
    """Return the conventions whose turns are clearly nearer to those seen than the turns of poses as they are."""
    found = {name: compare(posed, reading) for name, reading in READINGS.items()}
    clear = {name: misfit for name, misfit in found.items() if misfit.fits and _is_finer(misfit, given)}
    best = min((misfit.turns_off_deg.mean() for misfit in clear.values()), default=0.0)
    return [name for name, misfit in clear.items() if misfit.turns_off_deg.mean() < best + FINER_DEG]


def _is_finer(misfit: Misfit, given: Misfit) -> bool:
    """Tell whether turns by one reading are nearer to those seen than by another: on average, and in most motions."""
    one, other = misfit.turns_off_deg, given.turns_off_deg
    nearer = one.mean() < FINER * other.mean() and other.mean() - one.mean() > FINER_DEG
    return bool(len(one) >= FEWEST_FINE and nearer and np.mean(one < other) >= MOST)


def _name_scale(posed: Sequence[Sample], ratio: float, by: str | None) -> str:
    """Say that the poses are in another unit."""
    times = f"{three_digits(ratio)} times" if ratio > 1 else f"1/{three_digits(1 / ratio)} of"
    text = f"their motion is {times} what {_eyes(by)}"
    name, chained = next((name, reading) for name, reading in READINGS.items() if "chain" in name)
    steps = compare(posed, chained)
    if steps.fits and max(steps.ratio, 1 / steps.ratio) < LONGER:
        return f"{text}; they fit if they are {name}"
    or_map = f"; or the {by} maps are in another unit" if by in ("truth", "sparse") else ""
    return f"{text}: {name_factor(ratio, POSE_FACTORS)}{or_map}"


def judge_direction(path: Trajectory, *, pair: bool) -> Iterator[Finding]:
    """Judge by poses alone: a camera that is fixed to a car moves along its own z, or at a steady angle to it.

    Args:
        path: the poses.
        pair: whether the camera belongs to a stereo pair, which looks forward.
    """
    moves = path.steps_m >= STILL_M
    if not moves.any():
        return
    steps_m = np.diff(path.T_world_rig[:, :3, 3], axis=0)[moves] / path.steps_m[moves, None]
    own = np.einsum("nji,nj->ni", path.T_world_rig[:-1, :3, :3][moves], steps_m)
    x, y, z = np.median(own, axis=0)
    guess = "are they inverted (world to camera)"
    if z < -0.7:
        guess += ", or in OpenGL's axes (y up, z backward), or is it a rear camera?"
        yield Finding("warning", "poses", f"the camera moves backwards: {guess}")
    elif abs(y) > 0.6 or np.linalg.norm(own.mean(axis=0)) < 0.6:
        guess += ", or in other axes than x right, y down, z forward?"
        yield Finding("warning", "poses", f"the camera moves along none of its own axes: {guess}")
    elif pair and abs(x) > 0.8:
        guess += ", or of axes with x forward, y left, z up, or does it look to the side?"
        yield Finding("warning", "poses", f"the camera moves sideways: {guess}")


def _angle(one: Matrix, other: Matrix) -> float:
    """Return the angle between two vectors (3,), degrees; 90 where one has no length."""
    lengths = float(np.linalg.norm(one) * np.linalg.norm(other))
    if lengths < 1e-9:
        return 90.0
    return float(np.degrees(np.arccos(np.clip(one @ other / lengths, -1, 1))))


def _turn(R: Matrix) -> float:
    """Return a rotation's angle (3, 3), degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))
