"""Triangles with what shading needs: surface coordinates in metres, material, colour and a key for its texture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]
BAR_M = 2.5
UNIT_PANE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
"""Surface coordinates of a pane that carries one picture."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """A soup of n triangles."""

    corners: Floats
    """(n, 3, 3) metres."""
    uv: Floats
    """(n, 3, 2) surface coordinates of the corners: metres, or 0..1 across a pane."""
    normal: Floats
    """(n, 3, 3) normals of the corners for shading, unit; 0 where the triangle is flat."""
    material: npt.NDArray[np.uint8]
    """(n,) index into materials.Material."""
    tint: Floats
    """(n, 3) linear RGB albedo."""
    key: Floats
    """(n,) what shifts the texture, so that two objects never wear the same; also a pane's own random number."""

    def __len__(self) -> int:
        return len(self.corners)


class Finish(NamedTuple):
    """What the faces of a part look like."""

    material: int
    """One Material."""
    tint: npt.ArrayLike
    """(3,), or (n, 3) for n faces: linear RGB albedo."""
    key: npt.ArrayLike = 0.0
    """One number, or (n,): what shifts the texture."""


def merge(parts: Sequence[Mesh]) -> Mesh:
    """Put meshes into one."""
    return Mesh(*(np.concatenate([getattr(part, name) for part in parts]) for name in Mesh.__slots__))


def quads(
    corners: npt.ArrayLike, finish: Finish, uv: npt.ArrayLike | None = None, normal: Floats | None = None
) -> Mesh:
    """Make quads of corners (n, 4, 3) or (4, 3), given around the edge.

    Args:
        corners: metres.
        finish: of the n quads.
        uv: (4, 2) or (n, 4, 2); default: the corners seen along the axis that each quad faces most.
        normal: (n, 4, 3) for smooth shading; default: flat.
    """
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 4, 3)
    n = len(points)
    places = facing_uv(points) if uv is None else np.broadcast_to(np.asarray(uv, np.float32), (n, 4, 2))
    bent = np.zeros((n, 4, 3), np.float32) if normal is None else normal.astype(np.float32)
    halves = [0, 1, 2, 0, 2, 3]
    return Mesh(
        points[:, halves].reshape(-1, 3, 3),
        places[:, halves].reshape(-1, 3, 2).astype(np.float32),
        bent[:, halves].reshape(-1, 3, 3),
        np.full(2 * n, finish.material, np.uint8),
        np.repeat(np.broadcast_to(np.asarray(finish.tint, np.float32), (n, 3)), 2, axis=0),
        np.repeat(np.broadcast_to(np.asarray(finish.key, np.float32), (n,)), 2),
    )


def facing_uv(points: Floats) -> Floats:
    """Return (n, 4, 2): the two coordinates other than the axis that each quad (n, 4, 3) faces most."""
    a, b = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    normal = np.abs(
        np.stack(
            [
                a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
                a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
                a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
            ],
            axis=1,
        )
    )
    axes = np.array([[1, 2], [0, 2], [0, 1]])[np.argmax(normal, axis=1)]
    return np.take_along_axis(points, axes[:, None, :], axis=2)


def box(low: npt.ArrayLike, high: npt.ArrayLike, finish: Finish) -> Mesh:
    """Make a box between two corners (3,), metres."""
    return boxes(np.stack([np.asarray(low, float), np.asarray(high, float)]), finish)


def boxes(ends: npt.ArrayLike, finish: Finish) -> Mesh:
    """Make boxes (n, 2, 3), each between two corners, metres."""
    span = np.asarray(ends, np.float32).reshape(-1, 2, 3)
    pick = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    p = np.stack([span[:, pick[:, axis], axis] for axis in range(3)], axis=-1)
    faces = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    return quads(p[:, faces].reshape(-1, 4, 3), finish)


def bar(low: npt.ArrayLike, high: npt.ArrayLike, finish: Finish) -> Mesh:
    """Make a box that is long in x, cut every few metres so that it can follow a bent street."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    cuts = np.linspace(a[0], b[0], max(1, int(np.ceil((b[0] - a[0]) / BAR_M))) + 1)
    ends = np.stack([np.broadcast_to(a, (len(cuts) - 1, 3)), np.broadcast_to(b, (len(cuts) - 1, 3))], axis=1).copy()
    ends[:, 0, 0], ends[:, 1, 0] = cuts[:-1], cuts[1:]
    return boxes(ends, finish)


def loft(rings: npt.ArrayLike, finish: Finish, uv: Floats | None = None, smooth: bool = False) -> Mesh:
    """Span quads between neighbouring rings (m, k, 3), with uv (m, k, 2); smooth shades them as one curved surface."""
    points = np.asarray(rings, dtype=np.float32)
    normal = None
    if smooth:
        across = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
        normal = _cells(across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9))
    return quads(_cells(points), finish, None if uv is None else _cells(uv), normal)


def _cells(grid: npt.NDArray[np.floating]) -> Floats:
    """Turn values at grid points (m, k, c) into those at the corners of its cells (n, 4, c)."""
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    return corners.reshape(-1, 4, grid.shape[-1]).astype(np.float32)


def tube(start: npt.ArrayLike, end: npt.ArrayLike, radii: tuple[float, float], finish: Finish, sides: int = 8) -> Mesh:
    """Make an open, tapered, smooth tube from start to end (3,), metres; uv is (around, along) in metres."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    across = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    circle = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(along, across)
    rings = np.stack([a + radii[0] * circle, b + radii[1] * circle])
    around, length = angle * max(radii), float(np.linalg.norm(b - a))
    uv = np.stack([np.column_stack([around, np.full(sides + 1, z)]) for z in (0.0, length)])
    return quads(_cells(rings), finish, _cells(uv), _cells(np.stack([circle, circle])))


def disc(centre: npt.ArrayLike, axis: int, radius: float, finish: Finish, sides: int = 12) -> Mesh:
    """Make a disc that faces along a coordinate axis; uv is -1..1 across it."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    rim = np.zeros((sides + 1, 3))
    rim[:, (axis + 1) % 3], rim[:, (axis + 2) % 3] = np.cos(angle), np.sin(angle)
    flat = rim[:, [(axis + 1) % 3, (axis + 2) % 3]]
    middle = np.broadcast_to(np.asarray(centre, float), (sides, 3))
    corners = np.stack([middle, middle + radius * rim[:-1], middle + radius * rim[1:], middle], axis=1)
    zero = np.zeros((sides, 2))
    return quads(corners, finish, np.stack([zero, flat[:-1], flat[1:], zero], axis=1))


def place(mesh: Mesh, position: npt.ArrayLike, yaw_rad: float = 0.0, scale: float = 1.0, key: float = 0.0) -> Mesh:
    """Turn a mesh about z, scale it and move it; its texture keeps its place on it, shifted by key."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]], dtype=np.float32)
    corners = (mesh.corners @ turn) * np.float32(scale) + np.asarray(position, np.float32)
    return replace(mesh, corners=corners, normal=mesh.normal @ turn, key=mesh.key + np.float32(key))


def mirror(mesh: Mesh, side: int) -> Mesh:
    """Turn a mesh built for the left side (y > 0) into one for the given side (1 = left, -1 = right)."""
    flip = np.array([1, side, 1], np.float32)
    return replace(mesh, corners=mesh.corners * flip, normal=mesh.normal * flip)
