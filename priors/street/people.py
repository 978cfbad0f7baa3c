"""People: lofted figures, standing or in mid-step."""

import numpy as np
import numpy.typing as npt

from priors.street import mesh
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh

CLOTHES = np.array(
    [
        [0.03, 0.03, 0.04],
        [0.05, 0.07, 0.15],
        [0.25, 0.24, 0.22],
        [0.22, 0.03, 0.03],
        [0.08, 0.10, 0.06],
        [0.4, 0.38, 0.34],
    ]
)
SKIN = [0.38, 0.25, 0.18]
# Height as a share, half depth (x) and half width (y) in metres: from the hips to the neck, and a head.
TORSO = np.array([[0.46, 0.11, 0.16], [0.52, 0.12, 0.17], [0.62, 0.10, 0.15], [0.72, 0.12, 0.20], [0.80, 0.10, 0.21],
                  [0.835, 0.06, 0.10]])  # fmt: skip
HEAD = np.array([[0.82, 0.05, 0.05], [0.87, 0.08, 0.07], [0.92, 0.10, 0.08], [0.97, 0.085, 0.07], [1.0, 0.02, 0.02]])


def person(rng: np.random.Generator) -> Mesh:
    """Build a person at the origin who walks along x."""
    height = rng.uniform(1.55, 1.9)
    jacket, trousers = CLOTHES[rng.integers(len(CLOTHES), size=2)] * rng.uniform(0.6, 1.3, (2, 1))
    hair = np.array([0.03, 0.02, 0.015]) * rng.uniform(0.5, 5)
    key = float(rng.uniform(0, 999))
    stride = rng.uniform(0.05, 0.3)
    parts = [
        _figure(TORSO, height, jacket, key),
        _figure(HEAD[:3], height, SKIN, key),
        _figure(HEAD[2:], height, hair, key),
    ]
    hip, shoulder = 0.5 * height, 0.79 * height
    for side in (1, -1):
        foot, hand = [side * stride, side * 0.10, 0.0], [-side * 0.8 * stride, side * 0.24, 0.45 * height]
        parts += [
            mesh.tube(foot, [0, side * 0.08, hip], (0.06, 0.09), Finish(Material.CLOTH, trousers, key)),
            mesh.box(
                [foot[0] - 0.08, foot[1] - 0.05, 0],
                [foot[0] + 0.17, foot[1] + 0.05, 0.09],
                Finish(Material.CLOTH, [0.02] * 3),
            ),
            mesh.tube(hand, [0, side * 0.2, shoulder], (0.04, 0.06), Finish(Material.CLOTH, jacket, key)),
        ]
    return mesh.merge(parts)


def _figure(profile: npt.NDArray[np.floating], height: float, tint: npt.ArrayLike, key: float) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, 13)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    flat = profile[:, None, 1:] * circle
    z = np.broadcast_to(profile[:, :1, None] * height, (*flat.shape[:2], 1))
    return mesh.loft(np.concatenate([flat, z], axis=2), Finish(Material.CLOTH, tint, key), smooth=True)
