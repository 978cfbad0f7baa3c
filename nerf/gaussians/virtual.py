"""Virtual views: what the warp shows between training frames is learned beside the frames themselves.

Where training views are few, Gaussians fit each of them, and nothing holds what lies between: training views come out
5 dB better than held-out ones. The warp (nerf/warp) draws the nearest frames into any view by their prior, without
training. So a view from a place between two neighbouring frames is one more picture to learn from, where the warp
shows a surface. GeoAug (Chen et al., ECCV 2022) does this for NeRFs of a few images; FSGS (Zhu et al., ECCV 2024)
trains Gaussians on views between the given ones.
"""

from collections import OrderedDict

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation, Slerp
from torch import Tensor

from nerf.gaussians.shot import Shot
from nerf.gaussians.types import Viewpoint
from nerf.scene import Scene
from nerf.warp.draw import Warp
from nerf.warp.frames import unlike_m
from priors.types import Matrix

PARTS = 4
"""Views are drawn at the places that divide the way between two frames into so many parts."""
NEIGHBOURS = 2
"""A frame has ways to so many training frames at most: on a path, to the one before it and to the one behind it."""
LONG = 0.2
"""A way that is shorter than so much of the scene's usual depth has no views: its ends show all that is between."""
LOOKED = 8
"""Frames whose prior says what that depth is."""
KEPT_BYTES = 128 << 20
"""Pictures of so many bytes are kept: each is drawn once where all of them fit."""
Picture = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]
"""(h, w, 3) colours and (h, w) 1 where a frame shows the place."""


def is_virtual(step: int, share: float) -> bool:
    """Tell whether a step learns from a virtual view, where a share of all steps does."""
    return int((step + 1) * share) > int(step * share)


class VirtualViews:
    """The views between the training frames of a scene with a prior."""

    def __init__(self, scene: Scene, device: torch.device) -> None:
        """Find the ways between neighbours; DataError where the prior has no value."""
        self._scene, self._device, self._warp = scene, device, Warp(scene)
        every = ways(self._warp.frames.positions, scene)
        least_m = LONG * usual_depth_m(scene)
        far = [way for way in every if length_m(way, scene) >= least_m]
        self.share = len(far) / max(1, len(every))
        """Of all ways, those that have views."""
        self.places = [(*way, part) for way in far for part in range(1, PARTS)]
        """Two training frames each, and after how many parts of the way between them."""
        self._kept: OrderedDict[int, Picture] = OrderedDict()

    def shot(self, seed: int, number: int) -> Shot:
        """Return the view of a number: all are drawn once, in an order by the seed, before any is drawn again."""
        lap, turn = divmod(number, len(self.places))
        order = np.random.Generator(np.random.Philox(key=[seed, lap])).permutation(len(self.places))
        which = int(order[turn])
        first, second, part = self.places[which]
        poses = self._scene.T_world_cam
        pose = pose_between(poses[first], poses[second], part / PARTS)
        rgb, shown = self._picture(which, pose)
        viewpoint = Viewpoint(self._scene.camera, pose)
        return Shot(None, viewpoint, self._tensor(rgb) / 255, None, None, None, self._tensor(shown))

    def _picture(self, which: int, pose: Matrix) -> Picture:
        """Draw a view, or find it."""
        if which not in self._kept:
            out = self._warp.fused(pose, self._scene.camera)
            drawn = np.rint(out.rgb.clip(0, 255)).astype(np.uint8), out.shown.astype(np.uint8)
            self._kept[which] = drawn
            while len(self._kept) > max(1, KEPT_BYTES // (drawn[0].nbytes + drawn[1].nbytes)):
                self._kept.popitem(last=False)
        self._kept.move_to_end(which)
        return self._kept[which]

    def _tensor(self, values: npt.NDArray[np.uint8]) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(self._device)


def ways(positions: list[int], scene: Scene) -> list[tuple[int, int]]:
    """List pairs of neighbouring frames, smaller position first; a frame alone has none.

    Two frames are neighbours where no third one is nearer to both (Toussaint's relative neighbourhood graph, 1980).
    """
    poses = scene.T_world_cam[positions]
    away = np.stack([unlike_m(poses, pose) for pose in poses])
    found: set[tuple[int, int]] = set()
    for first in range(len(positions)):
        order = np.argsort(away[first], kind="stable")
        for second in order[order != first][:NEIGHBOURS]:
            between = np.maximum(away[first], away[second]) < away[first, second]
            if not between.any():
                found.add((min(first, int(second)), max(first, int(second))))
    return sorted((positions[first], positions[second]) for first, second in found)


def length_m(way: tuple[int, int], scene: Scene) -> float:
    """Return how unlike two frames' views are, metres."""
    first, second = (scene.T_world_cam[position] for position in way)
    return float(unlike_m(first[None], second)[0])


def usual_depth_m(scene: Scene) -> float:
    """Return the median depth that the prior has in some of the training frames, metres; 0 where it has none."""
    assert scene.depth_m is not None
    some = [np.asarray(scene.depth_m[position]) for position in scene.train[:: -(-len(scene.train) // LOOKED)]]
    known = [depth_m[depth_m > 0] for depth_m in some if (depth_m > 0).any()]
    return float(np.median(np.concatenate(known))) if known else 0.0


def pose_between(first: Matrix, second: Matrix, share: float) -> Matrix:
    """Return the pose (4, 4) after a share of the way: places along a line, directions along an arc."""
    turned = Slerp([0, 1], Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]])))
    pose = np.eye(4)
    pose[:3, :3] = turned(share).as_matrix()
    pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return pose
