"""Votes: which values of a frame's map other frames' maps agree with, and which they contradict.

A value of frame j lands in frame i. If i's own value there is about as far, each is a vote for the other. If i's is
twice as far, i looks through the place: one of the two is wrong, and each is a vote against the other. If it is half
as far, the place is hidden from i: often because it does not exist, so that counts against j's value, and a bit against
i's. In between they say nothing: what is far is not known better. (After Merrell et al., "Real-Time Visibility-Based
Fusion of Depth Maps", ICCV 2007. Were i's value asked as hard as j's, a road that is ten times too far would be agreed
on: a plane ten times as deep below the cameras looks the same from all of them.)

Values around each other that are about as far share their votes. Votes are counted a few times, each time by how far
their voters are trusted. The settings were chosen on KITTI drive 0009 and on a street.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.votes import Rules, Voter, pool, vote
from nerf.kernels.cpu.warp_draw import NONE
from nerf.warp.draw import between
from priors.machine import threads
from priors.types import Camera, Matrix

Floats = npt.NDArray[np.float32]
Trust: TypeAlias = npt.NDArray[np.uint8]

ROUNDS = 3
"""How often votes are counted."""
SHARPNESS = 3
"""Power of a voter's trust by which its vote counts: those that are half trusted hardly count."""
OWN = np.float32(0.1)
"""What speaks for a value before anybody has voted."""
RULES = Rules(agree=1.2, against=2.0, hidden=1.5, hides=0.3, layer=1.15, half_px=9)


@dataclass(frozen=True)
class Council:
    """Frames that vote on each other's values."""

    camera: Camera
    """Of all of them."""
    poses: dict[int, Matrix]
    """T_world_cam of each, by its number."""
    near: dict[int, list[int]]
    """Which others each is compared with."""
    depth_m: Callable[[int], Floats]
    """Reads a frame's map (h, w), metres, 0 = no value."""
    weight: Callable[[int], Floats]
    """Reads how much its values count before anybody has voted, (h, w) in [0, 1]."""

    def count(self, number: int, trusted: Callable[[int], Trust | None]) -> Trust:
        """Count the votes on one frame's values.

        Args:
            number: the frame.
            trusted: how far another frame's values were trusted in the round before; None: fully.

        Returns:
            (h, w) trust x 255; half of it: as many votes for as against.
        """
        inverse = inverse_of(self.depth_m(number))
        ballot, shared = np.zeros((2, *inverse.shape), np.float32), np.zeros((2, *inverse.shape), np.float32)
        for other in self.near[number]:
            vote(inverse, self._voter(other, number, trusted(other)), RULES, ballot)
        threads.over(len(inverse), lambda first, last: pool(inverse, ballot, RULES, first, last, shared))
        return np.rint(255 * (shared[0] + OWN) / (shared[0] + shared[1] + OWN)).astype(np.uint8)

    def _voter(self, other: int, number: int, trusted: Trust | None) -> Voter:
        """Return one frame as a voter on another."""
        there = between(self.camera, self.poses[number], self.camera, self.poses[other])
        here = between(self.camera, self.poses[other], self.camera, self.poses[number])
        voice = self.weight(other)
        if trusted is not None:
            voice = np.asarray(voice * (trusted / np.float32(255)) ** SHARPNESS, np.float32)
        return Voter(inverse_of(self.depth_m(other)), voice, here, there)


def inverse_of(depth_m: Floats) -> Floats:
    """Return a map's inverse depth, 1/m; NONE where it has no value."""
    known = (depth_m > 0) & np.isfinite(depth_m)
    return np.divide(np.float32(1), depth_m, out=np.full(depth_m.shape, NONE), where=known)
