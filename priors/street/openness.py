"""Ambient occlusion: how much of the sky each place sees. Doorways and the ground under cars are dark by it."""

import cv2
import numpy as np
import numpy.typing as npt

from priors.street.config import StreetConfig
from priors.street.noise import GOLDEN_ANGLE_RAD
from priors.street.path import BEHIND_M, Path
from priors.street.raycast import RayCaster

Floats = npt.NDArray[np.floating]
GRID_STEP_M = 1.0
HALF_WIDTH_M = 18.0
LEVELS_M = np.array([0.25, 0.8, 1.6, 3.0, 5.0, 8.0, 12.0])
RAYS = 20
PROBE_M = 0.45
"""How far off a surface its openness is read, metres: on it, half the neighbourhood would be inside the wall."""


class Openness:
    """Share of the sky seen, on a grid along the street, read by linear interpolation."""

    def __init__(self, config: StreetConfig, path: Path, caster: RayCaster) -> None:
        self._path = path
        self._start_m = 20.0 - BEHIND_M
        s = np.arange(self._start_m, config.length_m + 20, GRID_STEP_M)
        t = np.arange(-HALF_WIDTH_M, HALF_WIDTH_M + 0.1, GRID_STEP_M)
        x, y, z = path.grid(s, t)
        grid = np.stack(np.broadcast_arrays(x, y, z + LEVELS_M[:, None, None]), axis=-1)
        self._sides, self._columns = len(t), len(s)
        self._atlas = _sky_share(caster, grid.reshape(-1, 3).astype(np.float32)).reshape(-1, self._columns)

    def at(self, place: Floats, normal: Floats) -> Floats:
        """Return the share of the sky (n,) that surfaces at places (n, 3) with unit normals (n, 3) see."""
        reach = place + np.float32(PROBE_M) * normal
        s, t, centre_z = self._path.locate(reach[:, 0], reach[:, 1])
        column = np.clip((s - self._start_m) / GRID_STEP_M, 0, self._columns - 1)
        row = np.clip((t + HALF_WIDTH_M) / GRID_STEP_M, 0, self._sides - 1)
        level = np.interp(reach[:, 2] - centre_z, LEVELS_M, np.arange(len(LEVELS_M)))
        low = np.minimum(level.astype(np.int64), len(LEVELS_M) - 2)
        share = (level - low).astype(np.float32)
        below, above = (self._read(column, row + k * self._sides) for k in (low, low + 1))
        return below + share * (above - below)

    def _read(self, column: npt.NDArray[np.floating], row: npt.NDArray[np.floating]) -> Floats:
        n, width = len(column), 1024
        maps = np.zeros((2, -(-n // width) * width), np.float32)
        maps[0, :n], maps[1, :n] = column, row
        grid = maps.reshape(2, -1, width)
        return np.asarray(cv2.remap(self._atlas, grid[0], grid[1], cv2.INTER_LINEAR).reshape(-1)[:n], np.float32)


def _sky_share(caster: RayCaster, places: Floats) -> Floats:
    """Cast rays spread over the upper hemisphere from places (n, 3); return the share (n,) that escapes."""
    escaped = np.zeros(len(places), np.float32)
    number = np.arange(RAYS) + 0.5
    up = np.sqrt(1 - number / RAYS)  # cosine-weighted
    turn = GOLDEN_ANGLE_RAD * number
    flat = np.sqrt(1 - up * up)
    for direction in np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=1).astype(np.float32):
        escaped += ~caster.blocked_still(places, direction)
    return escaped / np.float32(RAYS)
