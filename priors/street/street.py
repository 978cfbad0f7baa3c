"""A procedural street: pictures with truth from any pose, and the rig's own drive through it."""

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.street import lidar, rig
from priors.street.config import StreetConfig
from priors.street.path import Ego
from priors.street.raycast import RayCaster
from priors.street.render import StreetRenderer, StreetView
from priors.street.world import World
from priors.types import Camera, FloatMap, Image, Mask, Matrix

Floats = npt.NDArray[np.floating]
FRAME_S = 0.1


class Street:
    """One procedural street; everything follows from its config, and so from its seed."""

    def __init__(self, seed: int, length_m: float = 340.0, config: StreetConfig | None = None) -> None:
        self.config = config or StreetConfig.draw(seed, length_m)
        self.world = World(self.config)
        self.ego = Ego(self.config, self.world.path)
        self.caster = RayCaster(self.world.still, self.world.bodies)
        self._renderer = StreetRenderer(self.world, self.caster)

    def T_world_cam(self, time_s: float) -> Matrix:
        """Return the left camera's pose (4, 4) on the rig's drive."""
        T: Matrix = self.ego.T_world_rig(time_s)[0] @ geometry.invert(rig.FACING)
        return T

    def T_world_velo(self, time_s: Floats) -> Matrix:
        """Return the LiDAR's poses (n, 4, 4) on the rig's drive at times (n,)."""
        T: Matrix = self.ego.T_world_rig(time_s) @ geometry.invert(rig.FACING) @ rig.T_left_velo()
        return T

    def view(self, T_world_cam: Matrix, camera: Camera, time_s: float = 0.0, noise_seed: int = 0) -> StreetView:
        """Draw what a camera sees from any pose (4, 4), at the time that decides where the traffic is."""
        rng = np.random.default_rng([self.config.seed, 7, noise_seed])
        return self._renderer.view(T_world_cam, camera, time_s, rng)

    def pair(
        self, T_world_cam: Matrix, camera: Camera, time_s: float = 0.0, noise_seed: int = 0
    ) -> tuple[Image, Image, FloatMap, Mask]:
        """Draw a stereo pair for a left camera's pose: left, right (h, w, 3), left's depth in metres and sky mask."""
        left = self.view(T_world_cam, camera, time_s, 2 * noise_seed)
        right = self.view(rig.right_of(T_world_cam), camera, time_s, 2 * noise_seed + 1)
        return left.image, right.image, left.depth_m, left.sky

    def sweep(self, time_s: float, noise_seed: int = 0) -> tuple[Floats, Floats]:
        """Measure one LiDAR turn on the rig's drive: points (n, 4) x y z reflectance, times (n,); see lidar.scan."""
        rng = np.random.default_rng([self.config.seed, 8, noise_seed])
        material, tint = self.surfaces()
        return lidar.scan(self.caster, material, tint, self.T_world_velo, time_s, rng)

    def surfaces(self) -> tuple[npt.NDArray[np.uint8], Floats]:
        """Return material (n,) and tint (n, 3) of the world's triangles, as `lidar.scan` wants them."""
        return self._renderer.surfaces()
