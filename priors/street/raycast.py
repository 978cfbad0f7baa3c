"""Ray casting: rays against a still mesh and the cars that move through it, by Embree."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from priors.street.mesh import Mesh

Floats = npt.NDArray[np.floating]
Times = npt.NDArray[np.floating]
BODY_RANGE_M = 250.0
"""Bodies farther than this from every ray's origin are left out, metres."""
WANDER_M = 3.0
"""How far a body may be from its middle place within one turn of the scanner, metres."""


@dataclass(frozen=True, slots=True)
class Hits:
    """What n rays met."""

    distance: Floats
    """(n,) in lengths of the ray's direction; infinite where nothing was met."""
    triangle: npt.NDArray[np.int32]
    """(n,) index into the scene's triangles, still ones first; -1 = nothing."""
    weights: Floats
    """(n, 2) barycentric weights of the triangle's second and third corner."""
    normal: Floats
    """(n, 3) unit normal in the world, turned towards the ray's origin; 0 where nothing was met."""


@dataclass(frozen=True)
class Body:
    """A rigid thing that moves."""

    mesh: Mesh
    """In its own frame: x forward, y left, z up."""
    pose: Callable[[Times], Times]
    """T_world_body (n, 4, 4) at times (n,)."""


class RayCaster:
    """A still mesh and bodies, ready for rays."""

    def __init__(self, still: Mesh, bodies: Sequence[Body] = ()) -> None:
        self._still = _build(still)
        self._bodies = [(_build(body.mesh), body) for body in bodies]
        starts = np.cumsum([len(still), *(len(body.mesh) for body in bodies)])
        self._starts = starts.astype(np.int32)

    def cast(self, origins: Floats, directions: Floats, time_s: Times | float) -> Hits:
        """Find what rays (n, 3) from (n, 3) or one origin (1, 3) meet first at their times (n,), or at one time."""
        starts = np.ascontiguousarray(np.broadcast_to(origins, directions.shape))
        still = self._still.run(starts, directions, query="INTERSECT", output=True)
        distance = np.where(still["primID"] >= 0, still["tfar"], np.float32(np.inf))
        triangle, normal = still["primID"], still["Ng"]
        weights = np.stack([still["u"], still["v"]], axis=1)
        for (scene, body), start in zip(self._bodies, self._starts, strict=False):
            near, T_world_body = _near(body, origins, directions, time_s, distance)
            if near.size == 0:
                continue
            inside = _into(T_world_body, starts[near], directions[near])
            moving = scene.run(*inside, query="INTERSECT", output=True)
            nearer = (moving["primID"] >= 0) & (moving["tfar"] < distance[near])
            hit = near[nearer]
            distance[hit], triangle[hit] = moving["tfar"][nearer], moving["primID"][nearer] + start
            weights[hit] = np.stack([moving["u"], moving["v"]], axis=1)[nearer]
            rotation = T_world_body[:, :3, :3][nearer if len(T_world_body) > 1 else slice(None)]
            normal[hit] = np.einsum("nij,nj->ni", np.broadcast_to(rotation, (len(hit), 3, 3)), moving["Ng"][nearer])
        return Hits(distance, triangle, weights, _towards(normal, directions))

    def blocked_still(self, origins: Floats, direction: Floats) -> npt.NDArray[np.bool_]:
        """Tell which points (n, 3) have something still between them and a light far away along direction (3,)."""
        directions = np.ascontiguousarray(np.broadcast_to(direction, origins.shape))
        dark: npt.NDArray[np.bool_] = self._still.run(origins, directions, query="OCCLUDED") >= 0
        return dark

    def blocked(self, origins: Floats, direction: Floats, time_s: float) -> npt.NDArray[np.bool_]:
        """Tell the same with the moving bodies at a time taken in."""
        dark = self.blocked_still(origins, direction)
        for scene, body in self._bodies:
            near, T_world_body = _near(body, origins, direction[None], time_s, None)
            near = near[~dark[near]]
            if near.size:
                directions = np.broadcast_to(direction, (near.size, 3))
                dark[near] = scene.run(*_into(T_world_body, origins[near], directions), query="OCCLUDED") >= 0
        return dark


def _build(mesh: Mesh) -> EmbreeScene:
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(mesh.corners))
    one = np.array([[0, 0, 0]], np.float32), np.array([[0, 0, 1]], np.float32)
    scene.run(*one)  # the first query builds the tree: here, not in whichever thread comes first
    return scene


def _near(
    body: Body, origins: Floats, directions: Floats, time_s: Times | float, distance: Floats | None
) -> tuple[npt.NDArray[np.int64], Floats]:
    """Return the rays that pass the body's bounding ball before `distance`, and its poses for them (or its one)."""
    low, high = body.mesh.corners.min(axis=(0, 1)), body.mesh.corners.max(axis=(0, 1))
    centre, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    times = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    T_world_middle = body.pose(times[[len(times) // 2]])[0]
    if len(times) > 1:
        radius += WANDER_M
    offset = (T_world_middle[:3, :3] @ centre + T_world_middle[:3, 3]).astype(np.float32) - origins
    if np.einsum("ni,ni->n", offset, offset).min() > BODY_RANGE_M**2:
        return np.zeros(0, np.int64), T_world_middle[None].astype(np.float32)
    along, length2 = _dot(offset, directions), _dot(directions, directions)
    apart2 = _dot(offset, offset) - along * along / length2
    reach = radius * np.sqrt(length2)
    near = (apart2 < radius**2) & (along > -reach)
    if distance is not None:
        near &= along < distance * length2 + reach
    rays = np.flatnonzero(near)
    pose = body.pose(times[rays]) if len(times) > 1 else T_world_middle[None]
    return rays, pose.astype(np.float32)


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the products (n,) of vectors (n, 3), where either may be a single one (1, 3)."""
    if len(a) == 1:
        return b @ a[0]
    return a @ b[0] if len(b) == 1 else np.einsum("ni,ni->n", a, b)


def _into(T_world_body: Floats, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Express rays in the body's frame."""
    back = np.broadcast_to(np.swapaxes(T_world_body[:, :3, :3], 1, 2), (len(origins), 3, 3))
    start = np.einsum("nij,nj->ni", back, origins - T_world_body[:, :3, 3])
    return np.ascontiguousarray(start), np.ascontiguousarray(np.einsum("nij,nj->ni", back, directions))


def _towards(normal: Floats, directions: Floats) -> Floats:
    length = np.sqrt(np.einsum("ni,ni->n", normal, normal))
    away = np.einsum("ni,ni->n", normal, directions) > 0
    return normal * (np.where(away, np.float32(-1), np.float32(1)) / np.maximum(length, np.float32(1e-20)))[:, None]
