"""Frames that the warp draws from: a scene's training frames that have a prior, each made ready when it is needed."""

import hashlib
from collections import OrderedDict

import numpy as np
import numpy.typing as npt

from nerf.scene import Scene
from nerf.warp.surface import Surface, surface_of
from priors.errors import DataError
from priors.types import Matrix

KEPT = 8
"""Surfaces that are kept ready: neighbouring views draw from the same frames."""
TURN_M = 10.0
"""A camera turned by 1 radian is as unlike as one that is so many metres away."""


class Frames:
    """A scene's training frames with a prior."""

    def __init__(self, scene: Scene) -> None:
        """Find the frames; DataError where there is no prior."""
        if scene.depth_m is None:
            raise DataError(f"{scene.name}: the warp shows training frames by a prior's depth: name a prior")
        self.scene, self._ready = scene, OrderedDict[int, Surface]()
        self.positions = [position for position in scene.train if (scene.depth_m[position] > 0).any()]
        if not self.positions:
            raise DataError(f"{scene.name}: the prior has no value in any training frame: build or filter it anew")

    def nearest(self, T_world_cam: Matrix, most: int) -> list[int]:
        """Return the positions of the frames nearest to a pose, by place and by where the camera looks."""
        poses = self.scene.T_world_cam[self.positions]
        order = np.argsort(unlike_m(poses, T_world_cam), kind="stable")
        return [self.positions[index] for index in order[:most]]

    def surface(self, position: int) -> Surface:
        """Return a frame's depth, ready to be drawn."""
        if position not in self._ready:
            weight = None if self.scene.weight is None else self.scene.weight[position]
            self._ready[position] = surface_of(self._depth_m(position), weight)
            if len(self._ready) > KEPT:
                self._ready.popitem(last=False)
        self._ready.move_to_end(position)
        return self._ready[position]

    def digest(self) -> str:
        """Return a hash of all that views are made of but the images, which the run's drive names."""
        sums = hashlib.sha256(repr(self.positions).encode() + self.scene.T_world_cam.tobytes())
        for position in self.positions:
            sums.update(self._depth_m(position).tobytes())
            if self.scene.weight is not None:
                sums.update(self.scene.weight[position].tobytes())
        return sums.hexdigest()[:16]

    def _depth_m(self, position: int) -> npt.NDArray[np.float32]:
        assert self.scene.depth_m is not None
        return self.scene.depth_m[position]


def unlike_m(poses: npt.NDArray[np.float64], T_world_cam: Matrix) -> npt.NDArray[np.float64]:
    """Return how unlike poses (n, 4, 4) are one, (n,) metres: by place, and by where the camera looks."""
    away_m = np.linalg.norm(poses[:, :3, 3] - T_world_cam[:3, 3], axis=1)
    cosine = np.clip(poses[:, :3, 2] @ T_world_cam[:3, 2], -1, 1)
    return np.asarray(away_m + TURN_M * np.arccos(cosine))
