"""Drift: do poses leave flow over, always to one side, and do positions travel where velocities go?

A conventions' error (axes.py) is many degrees; what is judged here is tenths of one, which blurs accumulated sweeps and
radiance fields all the same.
"""

from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.egomotion.corners import follow
from priors.egomotion.residual import Residual, residual
from priors.egomotion.sight import WIDEST_PX, Sight, halve_camera
from priors.geometry import invert
from priors.pairs.matching import halve
from priors.types import Drive

FEWEST = 3
"""Pairs of frames that must show it."""
LEAST_PX, SHARE = 0.15, 6e-4
"""Residual flow that is told: so many pixels, and so much of the focal length (0.43 px of KITTI's 721)."""
DISAGREE_DEG = 0.75


@runtime_checkable
class Travelling(Protocol):
    """A drive that records positions and velocities."""

    def travel_deg(self) -> tuple[float, float] | None:
        """Return at which angle to its heading it travels, to the left, by positions and by velocities."""
        ...


def judge_drift(drive: Drive, sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Judge what poses leave over of the flow, and how positions and velocities agree."""
    yield from _judge_travel(drive)
    flows = [flow for sample in sampled if (flow := left_over(sample)) is not None]
    if len(flows) < FEWEST:
        return
    sideways, vertical = np.median(flows, axis=0).tolist()
    text = (
        f"after a frame, things lie {sideways:+.2f} px sideways, {vertical:+.2f} px vertically of where poses put them"
    )
    fx = sampled[0].frame.camera.fx
    if max(abs(sideways), abs(vertical)) > max(LEAST_PX, SHARE * fx):
        yield Finding("warning", "poses", f"{text}: sweeps and fields blur: refine them by `priors poses`")
    else:
        yield Finding("ok", "poses", text)


def left_over(sample: Sample) -> Residual | None:
    """Return the residual flow from a sampled frame to the one after, px of its image; None where it is not seen."""
    this, after, grey, other = sample.frame, sample.after, sample.grey, sample.follower
    depth_m = next((map_m for name, map_m in sample.depths.items() if name in ("stereo", "LiDAR")), None)
    if grey is None or other is None or depth_m is None or grey.shape != other.shape or after is None:
        return None
    if this.T_world_cam is None or after.T_world_cam is None:
        return None
    camera, scale = this.camera, 1
    while grey.shape[1] > WIDEST_PX:
        grey, other, camera, scale = halve(grey), halve(other), halve_camera(camera), 2 * scale
    sights = [Sight(image, depth_m[::scale, ::scale], camera, None) for image in (grey, other)]
    T_after_this = invert(after.T_world_cam) @ this.T_world_cam
    flow = residual(follow(sights[0], sights[1], T_after_this), T_after_this)
    return None if flow is None else Residual(*(scale * px for px in flow))


def _judge_travel(drive: Drive) -> Iterator[Finding]:
    """Compare where positions travel with where velocities go."""
    travel = drive.travel_deg() if isinstance(drive, Travelling) else None
    if travel is None:
        return
    by_position, by_velocity = travel
    text = f"positions travel at {by_position:+.2f} degrees to the heading, velocities at {by_velocity:+.2f}"
    if abs(by_position - by_velocity) < DISAGREE_DEG:
        yield Finding("ok", "poses", text)
    elif drive.describe().get("poses") == "dead-reckoned":
        yield Finding("note", "poses", f"{text}: positions drift, and poses are dead-reckoned from the velocities")
    else:
        yield Finding("warning", "poses", f"{text}: positions drift: leave --poses recorded out")
