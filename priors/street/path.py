"""The street's curve and the rig's way along it.

Street coordinates (s, t, z): s metres along the centre line, t metres to its left, z metres above the road. World
coordinates: x forward at the start, y left, z up. Meshes are built in street coordinates and then bent.
"""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.street.config import StreetConfig
from priors.types import Matrix

Values = npt.NDArray[np.floating]
BEHIND_M = 60.0
CURVE_STEP_M = 0.25


class Path:
    """The centre line of a street as a function of the distance along it."""

    def __init__(self, config: StreetConfig) -> None:
        rng = np.random.default_rng([config.seed, 2])
        self._s = np.arange(-BEHIND_M - 20, config.length_m + 900, CURVE_STEP_M)
        phase = rng.uniform(0, 2 * np.pi, 3)
        heading = self._headings(config, phase)
        slope = config.slope * np.sin(1.3 * 2 * np.pi / config.bend_wave_m * self._s + phase[2])
        self._heading = heading
        self._x, self._y = (self._integrate(f(heading)) for f in (np.cos, np.sin))
        self._z = self._integrate(slope)
        self._slope = slope
        self._table = np.stack([self._x, self._y, self._z, np.cos(heading), np.sin(heading)], axis=-1)

    def _headings(self, config: StreetConfig, phase: Values) -> Values:
        wave = 2 * np.pi / config.bend_wave_m
        return config.bend_rad * (np.sin(wave * self._s + phase[0]) + 0.5 * np.sin(0.41 * wave * self._s + phase[1]))

    def _integrate(self, rate: Values) -> Values:
        total = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * CURVE_STEP_M)])
        return total - np.interp(0.0, self._s, total)

    def heading_rad(self, s_m: npt.ArrayLike) -> Values:
        """Direction of the street, counter-clockwise from x."""
        return self._at(s_m, self._heading)

    def slope(self, s_m: npt.ArrayLike) -> Values:
        """Metres up a metre along."""
        return self._at(s_m, self._slope)

    def bend(self, street_m: Values) -> Values:
        """Map street coordinates (..., 3) to the world."""
        s, t, z = np.moveaxis(np.asarray(street_m, dtype=np.float64), -1, 0)
        place = (s - self._s[0]) / CURVE_STEP_M
        low = np.clip(place.astype(np.int64), 0, len(self._s) - 2)
        share = (place - low)[..., None]
        # One gather for all five: much faster than np.interp for millions of corners.
        x, y, up, cos, sin = np.moveaxis(self._table[low] * (1 - share) + self._table[low + 1] * share, -1, 0)
        return np.stack([x - t * sin, y + t * cos, z + up], axis=-1)

    def centre(self, s_m: npt.ArrayLike) -> tuple[Values, Values, Values]:
        """Return x, y and z of the centre line at s."""
        return self._at(s_m, self._x), self._at(s_m, self._y), self._at(s_m, self._z)

    def grid(self, s_m: Values, t_m: Values) -> tuple[Values, Values, Values]:
        """Return x (s,) and y (t, s) of places beside the centre line, and its z (s,): the street keeps to x."""
        x, y, z = self.centre(s_m)
        return x, y + t_m[:, None], z

    def locate(self, x_m: Values, y_m: Values) -> tuple[Values, Values, Values]:
        """Return s and t of places (n,), and z of the centre line there: the street never turns far from x."""
        s, y, z = (np.interp(x_m, self._x, of) for of in (self._s, self._y, self._z))
        return s, y_m - y, z

    def _at(self, s_m: npt.ArrayLike, of: Values) -> Values:
        return np.interp(np.asarray(s_m, dtype=np.float64), self._s, of)

    def pose(self, s_m: Values, t_m: Values, yaw_rad: float = 0.0) -> Matrix:
        """Return T_world_body (n, 4, 4) of bodies (x forward, y left, z up) that stand on the road at (s, t)."""
        T = np.tile(np.eye(4), (len(s_m), 1, 1))
        T[:, :3, 3] = self.bend(np.stack([s_m, t_m, np.zeros_like(s_m)], axis=-1))
        angles = np.stack([self.heading_rad(s_m) + yaw_rad, -np.cos(yaw_rad) * np.arctan(self.slope(s_m))], axis=-1)
        T[:, :3, :3] = Rotation.from_euler("ZY", angles).as_matrix()
        return T


class Ego:
    """The rig's motion: smooth speed, a little sway, yaw and nodding."""

    def __init__(self, config: StreetConfig, path: Path) -> None:
        rng = np.random.default_rng([config.seed, 3])
        self._path, self._config = path, config
        self._phase = rng.uniform(0, 2 * np.pi, 5)
        self._lane_t = -0.5 * config.lane_m if config.lanes == 2 else -config.lane_m
        self._sway_m = rng.uniform(0.1, 0.25)

    def along_m(self, time_s: Values) -> Values:
        """Distance driven at a time."""
        wave, share = 2 * np.pi / 9.0, 0.08
        ripple = np.cos(self._phase[0]) - np.cos(wave * time_s + self._phase[0])
        return self._config.speed_mps * (time_s + share / wave * ripple)

    def T_world_rig(self, time_s: npt.ArrayLike) -> Matrix:
        """Return poses (n, 4, 4) of the camera's place, with axes x forward, y left, z up, at times (n,)."""
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        wave = 2 * np.pi / 6.0
        offset = self._lane_t + self._sway_m * np.sin(wave * t + self._phase[1])
        drift = self._sway_m * wave * np.cos(wave * t + self._phase[1]) / self._config.speed_mps
        T_world_road = self._path.pose(self.along_m(t), offset)
        angles = np.stack(
            [
                drift + 0.004 * np.sin(2.1 * t + self._phase[2]),
                0.004 * np.sin(5.0 * t + self._phase[3]),
                0.005 * np.sin(3.3 * t + self._phase[4]),
            ],
            axis=-1,
        )
        T_road_rig = np.tile(np.eye(4), (len(t), 1, 1))
        T_road_rig[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
        T_road_rig[:, 2, 3] = self._config.camera_height_m
        return T_world_road @ T_road_rig
