"""A 64-line scanner that turns while the car drives: every azimuth is measured at its own time, from its own pose."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from priors.drives._velodyne import SECONDS_PER_RADIAN
from priors.street.materials import LASER_RETURN
from priors.street.raycast import RayCaster
from priors.types import Matrix

ELEVATIONS_RAD = np.radians(np.concatenate([np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)]))
AZIMUTHS = 2083
RANGE_M = 110.0
CLOSEST_M = 2.5
NOISE_M = 0.02


def scan(
    caster: RayCaster,
    material: npt.NDArray[np.uint8],
    tint: npt.NDArray[np.floating],
    T_world_velo: Callable[[npt.NDArray[np.floating]], Matrix],
    time_s: float,
    rng: np.random.Generator,
) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
    """Measure one turn around a reference time.

    Args:
        caster: what is measured.
        material: (triangles,) of the triangles.
        tint: (triangles, 3) of the triangles.
        T_world_velo: gives poses (n, 4, 4) of the scanner at times (n,).
        time_s: reference time.
        rng: makes noise and missing echoes.

    Returns:
        points (n, 4): metres in the scanner's frame at each point's own moment, and reflectance 0..1;
        times (n,): seconds from the reference time.
    """
    azimuth = np.pi - (np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS)
    times = SECONDS_PER_RADIAN * azimuth
    poses = T_world_velo(time_s + times)
    elevation = ELEVATIONS_RAD[:, None] + rng.normal(0, 2e-4, (64, AZIMUTHS))
    flat = np.cos(elevation)
    beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    rays = np.einsum("aij,eaj->eai", poses[:, :3, :3], beams).astype(np.float32).reshape(-1, 3)
    starts = np.broadcast_to(poses[:, :3, 3], beams.shape).astype(np.float32).reshape(-1, 3)
    when = np.broadcast_to(times, (64, AZIMUTHS)).reshape(-1)
    hits = caster.cast(np.ascontiguousarray(starts), rays, time_s + when)
    range_m = hits.distance.astype(np.float64)
    cos = np.abs(np.einsum("ni,ni->n", hits.normal, rays))
    echo = np.flatnonzero(np.isfinite(range_m) & (range_m > CLOSEST_M) & (range_m < RANGE_M))
    triangle = hits.triangle[echo]
    bright = tint[triangle].mean(axis=1)
    # Echo power falls with distance, slant and darkness; glass and gloss send it elsewhere.
    power = (0.25 + bright) * (0.15 + cos[echo]) * np.exp(-range_m[echo] / 60.0)
    chance = LASER_RETURN[material[triangle]] * np.clip(power / 0.035, 0, 1) * 0.985
    echo = echo[rng.random(len(echo)) < chance]
    range_m = range_m[echo] + rng.normal(0, NOISE_M, len(echo))
    xyz = beams.reshape(-1, 3)[echo] * range_m[:, None]
    shine = np.clip(
        tint[hits.triangle[echo]].mean(axis=1) * (0.4 + 0.6 * cos[echo]) + rng.normal(0, 0.02, len(echo)), 0, 0.99
    )
    return np.column_stack([xyz, shine]).astype(np.float32), when[echo]
