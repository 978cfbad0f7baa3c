"""Drawing: a view as the training frames nearest to it show it, by their prior's depth; nothing is trained."""

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.warp_draw import NONE, draw
from nerf.kernels.cpu.warp_fuse import Fused, Rules, Views, fuse
from nerf.scene import Scene
from nerf.types import RenderedView
from nerf.warp.fill import fill
from nerf.warp.frames import Frames
from priors.geometry import invert
from priors.machine import threads
from priors.types import Camera, Matrix

NEAREST = 4
"""Frames a view is made of."""
PARALLAX_RAD = 0.06
"""Parallax that makes two views of a place unlike by 1."""
FARTHEST_M = 1e4
"""Depth of what is infinitely far."""


class Warp:
    """A scene's training frames, drawn into any view. It works on the CPU."""

    def __init__(self, scene: Scene) -> None:
        """Take a scene with a prior; DataError where there is none, or no value in it."""
        self.frames = Frames(scene)

    def view(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Draw, compare and blend the nearest frames; what none of them shows is filled from around, with opacity 0."""
        out = self.fused(T_world_cam, camera)
        rgb = fill(out.rgb, out.shown) / np.float32(255)
        inverse = fill(out.inverse, out.inverse >= 0)
        depth_m = (1 / np.maximum(inverse, np.float32(1 / FARTHEST_M))).astype(np.float32)
        return RenderedView(np.clip(rgb, 0, 1), depth_m, depth_m, out.shown.astype(np.float32))

    def fused(self, T_world_cam: Matrix, camera: Camera) -> Fused:
        """Return what the nearest frames show of a view, with its holes."""
        positions = self.frames.nearest(T_world_cam, NEAREST)
        seen = self._draw(positions, T_world_cam, camera)
        out = Fused(
            np.zeros((*camera.size, 3), np.float32), np.full(camera.size, NONE), np.zeros(camera.size, np.bool_)
        )
        views, rules = self._views(positions, T_world_cam, camera), rules_for(self.frames.scene.camera)
        threads.over(camera.size[0], lambda first, last: fuse(seen, views, rules, first, last, out))
        return out

    def _draw(self, positions: list[int], T_world_cam: Matrix, camera: Camera) -> npt.NDArray[np.float32]:
        """Draw each frame's surface into the view: inverse depths (n, height, width)."""
        frames, seen = self.frames, np.full((len(positions), *camera.size), NONE)
        surfaces = [frames.surface(position) for position in positions]

        def draw_one(index: int) -> None:
            surface, pose = surfaces[index], frames.scene.T_world_cam[positions[index]]
            M = between(frames.scene.camera, pose, camera, T_world_cam)
            draw(surface.inverse, surface.joins, M, seen[index])

        threads.run(len(positions), draw_one)
        return seen

    def _views(self, positions: list[int], T_world_cam: Matrix, camera: Camera) -> Views:
        """Stack what the frames hold."""
        scene, surfaces = self.frames.scene, [self.frames.surface(position) for position in positions]
        there = [between(camera, T_world_cam, scene.camera, scene.T_world_cam[position]) for position in positions]
        images = np.stack([scene.images[position] for position in positions])
        inverse, trust = (np.stack([getattr(each, name) for each in surfaces]) for name in ("inverse", "trust"))
        return Views(images, inverse, trust, np.stack(there))


def between(camera: Camera, T_world_cam: Matrix, other: Camera, T_world_other: Matrix) -> npt.NDArray[np.float64]:
    """Return the matrix (3, 4) from a camera's pixels and inverse depths to another's: see warp_draw.py."""
    T_other_cam = invert(T_world_other) @ T_world_cam
    rotated = other.K @ T_other_cam[:3, :3] @ np.linalg.inv(camera.K)
    return np.hstack([rotated, other.K @ T_other_cam[:3, 3:]])


def rules_for(camera: Camera) -> Rules:
    """Return how frames of a camera are compared and blended."""
    return Rules(
        agree_px=2.0,
        agree_share=0.2,
        parallax_px=PARALLAX_RAD * camera.fx,
        shrinking=2.0,
        softness=0.3,
        own_vote=0.5,
        feather_px=8.0,
    )
