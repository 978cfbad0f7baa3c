"""Refined poses of a drive: what images see of the motion between neighbouring frames, fused with the recorded poses.

Seen motions are sure over a step and drift over many; recorded poses the other way round. Frames that are left out have
no part in what is seen: the recorded motions tie them to their neighbours, whose corrections they follow.
"""

from collections import OrderedDict
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
STEP_SHARE, STEP_M, STEP_RAD = 0.03, 0.005, 1e-3
"""How far off recorded motions are: a share of the way, a shift and a turn. Along the way they are surer."""
ALONG = 0.005
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
    edges = [*_places(recorded), *_steps(recorded)]
    followed: dict[tuple[int, int], tuple[Corners, Sight]] = {}
    sights: OrderedDict[int, Sight] = OrderedDict()
    for index, frame in enumerate(frames):
        on_frame()
        if frame.id in left_out:
            continue
        try:
            sights[index] = look(frame)
        except DataError:
            continue  # as if it were left out
        for before in [index - step for step in STEPS if index - step in sights]:
            T_this_before = invert(recorded[index]) @ recorded[before]
            if np.linalg.norm(T_this_before[:3, 3]) <= FARTHEST_M:
                followed[before, index] = follow(sights[before], sights[index], T_this_before), sights[before]
        while len(sights) > max(STEPS):
            sights.popitem(last=False)
    seen = []
    for (this, other), (corners, sight) in followed.items():
        motion = see(corners, sight.camera, sight.fx_baseline)
        if motion is not None:
            seen.append(Edge(this, other, motion.T_this_other, np.linalg.inv(motion.covariance)))
    if not seen:
        raise DataError("no motion can be seen between any two frames: are they of one drive, and sharp?")
    refined = solve(recorded, [*edges, *seen])
    before, after = (_residual(followed, poses) for poses in (recorded, refined))
    return Refined(refined, len(seen), before, after)


def _places(recorded: Sequence[Matrix]) -> list[Edge]:
    information = np.diag([PLACE_M**-2] * 3 + [PLACE_RAD**-2] * 3)
    return [Edge(None, n, T, information) for n, T in enumerate(recorded)]


def _steps(recorded: Sequence[Matrix]) -> list[Edge]:
    """Return the recorded motions from each frame to the next."""
    edges = []
    for n in range(len(recorded) - 1):
        T = invert(recorded[n]) @ recorded[n + 1]
        way_m = T[:3, 3] @ T[:3, :3]  # in the axes of the second frame
        length_m = float(np.linalg.norm(way_m))
        covariance = np.diag([(STEP_SHARE * length_m + STEP_M) ** 2] * 3 + [STEP_RAD**2] * 3)
        covariance[:3, :3] -= (STEP_SHARE**2 - ALONG**2) * np.outer(way_m, way_m)
        edges.append(Edge(n, n + 1, T, np.linalg.inv(covariance)))
    return edges


def _residual(
    followed: dict[tuple[int, int], tuple[Corners, Sight]], poses: Sequence[Matrix]
) -> npt.NDArray[np.float64]:
    """Return the median size (2,) of the residual flow between neighbours."""
    found = [
        residual(corners, sight.camera, invert(poses[other]) @ poses[this])
        for (this, other), (corners, sight) in followed.items()
        if other - this == 1
    ]
    return np.median(np.abs([flow for flow in found if flow is not None]), axis=0)
