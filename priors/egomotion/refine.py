"""Refined poses of a drive: what images see of the motion between neighbouring frames, fused with the recorded poses.

Seen motions are sure over a step and drift over many; recorded poses the other way round. Frames that are left out have
no part in what is seen: the recorded motions tie them to their neighbours, whose corrections they follow.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.egomotion.corners import Corners, follow
from priors.egomotion.graph import Edge, solve
from priors.egomotion.motion import see
from priors.egomotion.residual import residual
from priors.egomotion.sight import Look, Sight
from priors.errors import DataError
from priors.geometry import invert
from priors.types import Frame, Matrix

STEPS = (1, 2)
"""Frames are seen together with those so many after them: 2 bridges a frame that is left out."""
STEP_SHARE, ALONG_SHARE, STEP_M, STEP_RAD = 0.03, 0.005, 0.005, 1e-3
"""How far off recorded motions are: a share of the way to its sides and along it, a shift and a turn."""

PLACE_M, PLACE_RAD = 1.0, 0.02
"""How far off recorded poses are; with STEP_M this ties the path to them over some ten seconds."""
FARTHEST_M = 5.0
"""Frames farther apart share too little of the scene."""


@dataclass(frozen=True)
class Refined:
    """What came of it."""

    T_world_cam: list[Matrix]
    """A pose a frame."""
    seen: int
    """Motions that images showed."""
    before_px: npt.NDArray[np.float64]
    """(2,) sideways and vertical residual flow between neighbours, median of its size, by the recorded poses."""
    after_px: npt.NDArray[np.float64]
    """By the refined ones."""


def refine(
    frames: Sequence[Frame],
    look: Look,
    left_out: Collection[str] = (),
    on_frame: Callable[[], None] = lambda: None,
) -> Refined:
    """Refine the poses of frames in the order of time.

    Args:
        frames: all with a pose.
        look: makes a frame's sight.
        left_out: ids of frames whose images and sweeps are not looked at.
        on_frame: called after each frame.

    Raises:
        DataError: a frame has no pose, or no motion can be seen.
    """
    recorded = [frame.pose() for frame in frames]
    followed = _follow(frames, look, left_out, on_frame)
    seen = []
    for (this, other), corners in followed.items():
        motion = see(corners)
        if motion is not None:
            information = np.linalg.inv(motion.covariance).astype(np.float64)
            seen.append(Edge(this, other, motion.T_this_other, information))
    if not seen:
        raise DataError("no motion can be seen between any two frames: are they of one drive, and sharp?")
    refined = solve(recorded, [*_places(recorded), *_steps(recorded), *seen])
    return Refined(refined, len(seen), _residual(followed, recorded), _residual(followed, refined))


def _follow(
    frames: Sequence[Frame], look: Look, left_out: Collection[str], on_frame: Callable[[], None]
) -> dict[tuple[int, int], Corners]:
    """Follow corners from each frame to those STEPS after it, by the positions of the two."""
    followed: dict[tuple[int, int], Corners] = {}
    sights: dict[int, Sight] = {}
    for index, frame in enumerate(frames):
        on_frame()
        if frame.id in left_out:
            continue
        try:
            sights[index] = look(frame)
        except DataError:
            continue  # as if it were left out
        for step in STEPS:
            before = index - step
            if before not in sights:
                continue
            T_this_before = invert(frame.pose()) @ frames[before].pose()
            if np.linalg.norm(T_this_before[:3, 3]) <= FARTHEST_M:
                followed[before, index] = follow(sights[before], sights[index], T_this_before)
        sights = {n: sight for n, sight in sights.items() if n > index - max(STEPS)}
    return followed


def _places(recorded: Sequence[Matrix]) -> list[Edge]:
    deviations = np.array([PLACE_M] * 3 + [PLACE_RAD] * 3, dtype=np.float64)
    information: Matrix = np.diag(1 / np.square(deviations))
    return [Edge(None, n, T, information) for n, T in enumerate(recorded)]


def _steps(recorded: Sequence[Matrix]) -> list[Edge]:
    """Return the recorded motions from each frame to the next."""
    edges = []
    for n in range(len(recorded) - 1):
        T = invert(recorded[n]) @ recorded[n + 1]
        way_m = T[:3, 3] @ T[:3, :3]  # in the axes of the second frame
        covariance = np.diag([STEP_M**2 + STEP_SHARE**2 * float(way_m @ way_m)] * 3 + [STEP_RAD**2] * 3)
        covariance[:3, :3] -= (STEP_SHARE**2 - ALONG_SHARE**2) * np.outer(way_m, way_m)
        edges.append(Edge(n, n + 1, T, np.linalg.inv(covariance)))
    return edges


def _residual(followed: dict[tuple[int, int], Corners], poses: Sequence[Matrix]) -> npt.NDArray[np.float64]:
    """Return the median size (2,) of the residual flow between neighbours."""
    found = [
        residual(corners, invert(poses[other]) @ poses[this])
        for (this, other), corners in followed.items()
        if other - this == 1
    ]
    return np.asarray(np.median(np.abs([flow for flow in found if flow is not None]), axis=0))
