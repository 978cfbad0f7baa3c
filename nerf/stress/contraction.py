"""Rows of the table: contraction of space, its derivative, spacing along rays."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from nerf.space import Kind, Space
from nerf.stress.inputs import CENTRAL, NO_RAYS, NO_SAMPLES, NO_SIGMA, PARALLEL
from nerf.stress.rays import tensor
from nerf.twin import space as twin
from priors import origin
from priors.stress.inputs import FAR, Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_MASK, NO_POSES, Case, Outputs, Routine, without

KINDS: tuple[Kind, ...] = ("cube", "ball", "spheres", "box")
COUNT = 160
HALF_M, NEAR_M, FAR_M = (30.0, 12.0, 10.0), 0.5, 250.0
CENTRE_M = (3.0, -2.0, 1.5)
FAR_CENTRE_M = 1e30
"""Coordinates are held within this before anything else is done with them: nerf/space.py."""


def contraction(kind: Kind) -> Callable[[Given], Case]:
    """Return the case of places in a space: u in [0, 1] and the table that holds them."""

    def case(given: Given) -> Case:
        space, points_m, moved_m = _points(given, kind)
        ours = tensor(moved_m)

        def found() -> Outputs:
            u, table = space.warp(ours)
            return {"u": u, "table": table}

        def wanted() -> Outputs:
            u, table = formula(space, points_m)
            return {"u": u, "table": table}

        return Case(found, wanted, {"u": 1.0, "table": 1.0})

    return case


def _points(given: Given, kind: Kind) -> tuple[Space, Floats, Floats]:
    """Return a space, points (n, 3) of its frame, metres, and the same as the scene has them in float32.

    Where the world's origin is far, they come out of poses: what a scene takes off is taken off in float64.
    """
    size = given.size(COUNT)
    points_m = np.stack(list(given.values(0.5, 200, (3, *size), signed=True)), axis=1)
    if given.input is CENTRAL:
        points_m = np.array(CENTRE_M) + given.random.uniform(-2, 2, (*size, 1)) * (points_m - CENTRE_M)
    if given.input is PARALLEL:
        points_m[:, given.random.integers(0, 3)] = CENTRE_M[0]
    points_m = points_m.astype(np.float32).astype(np.float64)
    if given.input is not FAR:
        return Space(kind, CENTRE_M, HALF_M, NEAR_M, FAR_M), points_m, points_m
    poses = np.tile(np.eye(4), (len(points_m), 1, 1))
    poses[:, :3, 3] = points_m + given.far
    taken_m = np.array(origin.origin_of(poses))
    centre_m = tuple((np.array(CENTRE_M) + given.far - taken_m).tolist())
    own_m = poses[:, :3, 3] - taken_m
    return Space(kind, centre_m, HALF_M, NEAR_M, FAR_M), own_m, origin.without(tuple(taken_m), poses)[:, :3, 3]


def formula(space: Space, points_m: Floats) -> tuple[Floats, Any]:
    """Return u (n, 3) and table (n,) by the formulas of MipNeRF-360 (eq. 10), nerfstudio and NeRF++, in float64.

    A coordinate that is not finite is as far as any: its place is on the border.
    """
    held = np.clip(points_m - np.array(space.centre_m), -FAR_CENTRE_M, FAR_CENTRE_M)
    x = (held @ np.array(space.axes).T) / np.array(space.half_m)
    if space.kind == "box":
        return np.clip((x + 1) / 2, 0, 1), np.zeros(len(x))
    r = (np.abs(x).max(1) if space.kind == "cube" else np.sqrt((x**2).sum(1)))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(r <= 1, x, (2 - 1 / r) * (x / r))
    if space.kind != "spheres":
        return z / 4 + 0.5, np.zeros(len(x))
    return np.where(r <= 1, (x + 1) / 2, z / 4 + 0.5), (r[:, 0] > 1).astype(float)


def derivative(kind: Kind) -> Callable[[Given], Case]:
    """Return the case of the metres that a unit of u spans, away from the centre: 4 half r^2 outside, its mean half."""

    def case(given: Given) -> Case:
        space, _, moved_m = _points(given, kind)
        u, table = space.warp(tensor(moved_m))
        exact, outer = u.double().numpy(), table.numpy() > 0
        mean_m = float(np.prod(HALF_M) ** (1 / 3))

        def wanted() -> Outputs:
            if kind == "box":
                return {"metres": np.full(len(exact), 2 * mean_m)}
            z = 4 * exact - 2
            r = np.abs(z).max(1) if kind == "cube" else np.sqrt((z**2).sum(1))
            out = 1 / np.maximum(2 - r, 1 / space.farthest)
            metres = 4 * mean_m * np.where(r > 1, np.maximum(out, 1), 1) ** 2
            return {"metres": metres if kind != "spheres" else np.where(outer, metres, 2 * mean_m)}

        return Case(lambda: {"metres": space.stretch_m(u, table)}, wanted)

    return case


def spacing(given: Given) -> Case:
    """Turn depths into s and back; outside [near, far] they are held. s is even in depth, then in its inverse."""
    size = given.size(COUNT)
    depth_m, knee_m = given.values(0.5, 240, size), given.precision.rounded(given.random.uniform(2, 60, size))
    space = Space("ball", CENTRE_M, HALF_M, NEAR_M, FAR_M)
    ours, knee = tensor(depth_m), tensor(knee_m)

    def ramp(t: Any) -> Any:
        return np.where(t < knee_m, t / (2 * knee_m), 1 - knee_m / (2 * np.maximum(t, knee_m)))

    def found() -> Outputs:
        ramps = space.spacing(knee)
        s = twin.spacing(ours, ramps)
        return {"s": s, "depth": twin.depth(s, ramps)}

    def wanted() -> Outputs:
        low, high = ramp(np.full(size, NEAR_M)), ramp(np.full(size, FAR_M))
        held = np.where(np.isnan(depth_m), np.nan, np.clip(depth_m, NEAR_M, FAR_M))
        return {"s": (ramp(held) - low) / (high - low), "depth": held}

    # Beyond the knee s is even in 1 / t: what float32 cannot tell of s there is t^2 / knee of depth.
    scale = {"s": 1.0, "depth": np.maximum(FAR_M, FAR_M**2 / knee_m)}
    return Case(found, wanted, scale)


def ray_ends(given: Given) -> Case:
    """Find where rays leave the inner ball, and where they enter and leave a box."""
    size = given.size(COUNT)
    places = np.stack(list(given.values(0.05, 3, (3, *size), signed=True)), axis=1)
    ways = np.stack(list(given.plain(0.05, 0.5, (3, *size), signed=True)), axis=1)
    if given.input is CENTRAL:
        places = given.precision.rounded(given.random.uniform(-3, 3, (*size, 1)) * ways)
    if given.input is PARALLEL:
        ways[:, :2] = 0
    ours = tensor(places), tensor(ways)

    def found() -> Outputs:
        first, last = (torch.full(size, depth_m) for depth_m in (NEAR_M, FAR_M))
        enter, leave = twin.clip(*ours, first, last)
        return {"exit": twin.exits(*ours), "inside": (leave - enter).clamp(min=0)}

    def wanted() -> Outputs:
        wide = places.astype(np.longdouble), ways.astype(np.longdouble)
        return {"exit": _exit(*wide), "inside": _inside(*wide)}

    with np.errstate(all="ignore"):
        reach = np.abs(places).max(1) / np.abs(ways).max(1)
    scale = np.where(np.isfinite(reach), np.maximum(reach, 1 / np.abs(ways).max(1)), 1)
    return Case(found, wanted, {"exit": scale * EDGE, "inside": np.maximum(scale, FAR_M)}, spreads=True)


EDGE = 100.0
"""A ray that all but misses the ball meets it where a hundredth of its digits says."""


def _exit(place: Any, way: Any) -> Floats:
    a, b, c = (way**2).sum(1), (place * way).sum(1), (place**2).sum(1) - 1
    inside = b * b - a * c
    out = np.where(inside > 0, np.maximum((np.sqrt(np.maximum(inside, 0)) - b) / a, 0), 0)
    return np.asarray(np.where(np.isfinite(place).all(1), out, np.nan), np.float64)


def _inside(place: Any, way: Any) -> Floats:
    slope = np.where(np.abs(way) < 1e-12, 1e-12, way)
    one, other = (-1 - place) / slope, (1 - place) / slope
    enter = np.maximum(np.minimum(one, other).max(1), NEAR_M)
    leave = np.minimum(np.maximum(one, other).min(1), FAR_M)
    out = np.maximum(leave - enter, 0)
    return np.asarray(np.where(np.isfinite(place).all(1), out, np.nan), np.float64)


SOMEWHERE = without("inf", "NaN", why="a camera is somewhere: a pose that is not finite is refused")
SPACE = {**NO_SIGMA, **NO_SAMPLES, **NO_MASK, **without("NaN", why="a place that is no number is nowhere")}
RAYS = {**NO_SIGMA, **NO_SAMPLES, **NO_MASK, **NO_POSES}
ROUTINES = (
    *(Routine(f"contraction, {kind}", "nerf/space.py", contraction(kind), SPACE, FLOAT32_ONLY) for kind in KINDS),
    *(Routine(f"its derivative, {kind}", "nerf/space.py", derivative(kind), SPACE, FLOAT32_ONLY) for kind in KINDS),
    Routine("spacing along rays", "nerf/twin/space.py", spacing, {**RAYS, **NO_RAYS}, FLOAT32_ONLY),
    Routine("where rays enter and leave", "nerf/twin/space.py", ray_ends, {**RAYS, **SOMEWHERE}, FLOAT32_ONLY),
)
