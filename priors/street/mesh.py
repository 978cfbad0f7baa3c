"""Triangles with what shading needs: surface coordinates in metres, material, colour and a key for its texture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Mesh:
    """A soup of n triangles."""

    corners: Floats
    """(n, 3, 3) metres."""
    uv: Floats
    """(n, 3, 2) surface coordinates of the corners: metres, or 0..1 across a pane."""
    material: npt.NDArray[np.uint8]
    """(n,) index into materials.Material."""
    tint: Floats
    """(n, 3) linear RGB albedo."""
    key: Floats
    """(n,) what shifts the texture, so that two objects never wear the same; also a pane's own random number."""

    def __len__(self) -> int:
        return len(self.corners)


def merge(parts: Sequence[Mesh]) -> Mesh:
    """Put meshes into one."""
    return Mesh(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.material for part in parts]),
        np.concatenate([part.tint for part in parts]),
        np.concatenate([part.key for part in parts]),
    )


def quads(
    corners: npt.ArrayLike,
    material: int,
    tint: npt.ArrayLike,
    key: npt.ArrayLike = 0.0,
    uv: npt.ArrayLike | None = None,
) -> Mesh:
    """Make quads of corners (n, 4, 3) or (4, 3), given around the edge.

    Args:
        corners: metres.
        material: one Material.
        tint: (3,) or (n, 3) linear RGB.
        key: one number, or (n,).
        uv: (4, 2) or (n, 4, 2); default: the corners seen along the axis that each quad faces most.
    """
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 4, 3)
    n = len(points)
    places = facing_uv(points) if uv is None else np.broadcast_to(np.asarray(uv, np.float32), (n, 4, 2))
    halves = [0, 1, 2, 0, 2, 3]
    return Mesh(
        points[:, halves].reshape(-1, 3, 3),
        places[:, halves].reshape(-1, 3, 2).astype(np.float32),
        np.full(2 * n, material, np.uint8),
        np.repeat(np.broadcast_to(np.asarray(tint, np.float32), (n, 3)), 2, axis=0),
        np.repeat(np.broadcast_to(np.asarray(key, np.float32), (n,)), 2),
    )


def facing_uv(points: Floats) -> Floats:
    """Return (n, 4, 2): the two coordinates other than the axis that each quad (n, 4, 3) faces most."""
    normal = np.abs(np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]))
    axes = np.array([[1, 2], [0, 2], [0, 1]])[np.argmax(normal, axis=1)]
    return np.take_along_axis(points, axes[:, None, :], axis=2)


def box(low: npt.ArrayLike, high: npt.ArrayLike, material: int, tint: npt.ArrayLike, key: float = 0.0) -> Mesh:
    """Make a box between two corners (3,), metres."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float), np.asarray(high, float)
    p = [(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return quads([[p[i] for i in face] for face in faces], material, tint, key)


def loft(rings: npt.ArrayLike, material: int, tint: npt.ArrayLike, key: float = 0.0, closed: bool = False) -> Mesh:
    """Span quads between neighbouring rings (m, k, 3); closed joins each ring's last point with its first."""
    points = np.asarray(rings, dtype=np.float32)
    after = np.roll(points, -1, axis=1) if closed else points[:, 1:]
    here = points if closed else points[:, :-1]
    corners = np.stack([here[:-1], after[:-1], after[1:], here[1:]], axis=2)
    return quads(corners.reshape(-1, 4, 3), material, tint, key)


def tube(
    start: npt.ArrayLike,
    end: npt.ArrayLike,
    radii: tuple[float, float],
    material: int,
    tint: npt.ArrayLike,
    key: float = 0.0,
    sides: int = 8,
) -> Mesh:
    """Make an open, tapered tube from start to end (3,), metres; uv is (around, along) in metres."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    across = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    circle = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(along, across)
    rings = np.stack([a + radii[0] * circle, b + radii[1] * circle])
    corners = np.stack([rings[0, :-1], rings[0, 1:], rings[1, 1:], rings[1, :-1]], axis=1)
    around, length = angle * max(radii), float(np.linalg.norm(b - a))
    low, high = np.zeros(sides), np.full(sides, length)
    uv = np.stack([np.stack([around[:-1], low], 1), np.stack([around[1:], low], 1),
                   np.stack([around[1:], high], 1), np.stack([around[:-1], high], 1)], axis=1)  # fmt: skip
    return quads(corners, material, tint, key, uv)


def disc(centre: npt.ArrayLike, axis: int, radius: float, material: int, tint: npt.ArrayLike, key: float = 0.0,
         sides: int = 12) -> Mesh:  # fmt: skip
    """Make a disc that faces along a coordinate axis; uv is -1..1 across it."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    rim = np.zeros((sides + 1, 3))
    rim[:, (axis + 1) % 3], rim[:, (axis + 2) % 3] = np.cos(angle), np.sin(angle)
    flat = rim[:, [(axis + 1) % 3, (axis + 2) % 3]]
    middle = np.broadcast_to(np.asarray(centre, float), (sides, 3))
    corners = np.stack([middle, middle + radius * rim[:-1], middle + radius * rim[1:], middle], axis=1)
    zero = np.zeros((sides, 2))
    return quads(corners, material, tint, key, np.stack([zero, flat[:-1], flat[1:], zero], axis=1))


def place(mesh: Mesh, position: npt.ArrayLike, yaw_rad: float = 0.0, scale: float = 1.0, key: float = 0.0) -> Mesh:
    """Turn a mesh about z, scale it and move it; its texture keeps its place on it, shifted by key."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], dtype=np.float32)
    corners = (mesh.corners * np.float32(scale)) @ turn.T + np.asarray(position, np.float32)
    return Mesh(corners.astype(np.float32), mesh.uv, mesh.material, mesh.tint, mesh.key + np.float32(key))


def mirror(mesh: Mesh, side: int) -> Mesh:
    """Turn a mesh built for the left side (y > 0) into one for the given side (1 = left, -1 = right)."""
    return Mesh(mesh.corners * np.array([1, side, 1], np.float32), mesh.uv, mesh.material, mesh.tint, mesh.key)
