"""Scene: what there is to see of a drive and its priors, frame by frame. It knows no browser."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import cv2
import numpy as np

from priors.cache import Prior
from priors.codecs import as_rgb
from priors.errors import DataError
from priors.geometry import untwist
from priors.types import Drive, Frame, Image, Input, Matrix
from priors.view.cloud import Cloud, Colouring, back_project, empty, join, paint, place, sure_and_near
from priors.view.track import Track

MOST_POINTS = 400_000
"""Points that a browser on a small machine still turns smoothly."""
IMAGE_PX = 480
"""Width of an image in its frustum, at most."""


@dataclass(frozen=True)
class Choice:
    """What is looked at."""

    position: int = 0
    """Of the first frame shown, among the track's."""
    together: int = 1
    """How many frames' points are shown at once, from that one on."""
    prior: str | None = None
    """Name of the prior whose points are shown; None: none."""
    colouring: Colouring = "image"
    least_confidence: float = 0.0
    """Points that are less sure are left out, [0, 1]."""
    farthest_m: float = 80.0
    """Points with a larger camera-z depth are left out, metres."""
    sweeps: bool = False
    """Show the LiDAR's sweeps."""


@dataclass(frozen=True)
class Shown:
    """What a choice shows."""

    points: Cloud
    sweeps: Cloud
    remarks: tuple[str, ...] = ()
    """What is not there and why, one line each."""

    def caption(self) -> str:
        """Say how many points are seen, of how many."""
        return ", ".join(
            f"{len(cloud):,} of {cloud.whole:,} {what}" if len(cloud) < cloud.whole else f"{len(cloud):,} {what}"
            for cloud, what in ((self.points, "points"), (self.sweeps, "LiDAR points"))
            if cloud.whole
        )


MakeCloud: TypeAlias = Callable[[int, Choice, int], Cloud]


@dataclass(frozen=True)
class DriveScene:
    """A drive, some of its frames, and its priors."""

    drive: Drive
    indices: list[int]
    """Which of the drive's frames, in time order; not empty."""
    priors: dict[str, Prior] = field(default_factory=dict)
    """By the names that tables give them."""
    most: int = MOST_POINTS
    """Points shown at once, at most, of a prior and as many of sweeps."""

    @cached_property
    def track(self) -> Track:
        """Where the camera was."""
        return Track.of(self.drive, self.indices)

    @cached_property
    def has(self) -> frozenset[Input]:
        """What any of the frames has, of sweeps and true depth."""
        frames = [self.drive[index] for index in self.indices]
        kinds: tuple[Input, ...] = ("sweep", "truth")
        return frozenset(kind for kind in kinds if any(frame.has(kind) for frame in frames))

    def frame(self, position: int) -> Frame:
        """Return a frame."""
        return self.drive[self.indices[position]]

    def thumbnail(self, position: int) -> Image:
        """Read a frame's image, at most IMAGE_PX wide: (height, width, 3)."""
        image = as_rgb(self.frame(position).image())
        height, width = image.shape[:2]
        if width <= IMAGE_PX:
            return image
        size = IMAGE_PX, max(1, round(height * IMAGE_PX / width))
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def together(self, choice: Choice) -> range:
        """Return the positions that are shown at once; without poses it is one."""
        count = choice.together if self.track.posed else 1
        return range(choice.position, min(len(self.indices), choice.position + count))

    def show(self, choice: Choice) -> Shown:
        """Make the points of a choice; what cannot be read is a remark, and the rest is shown."""
        positions = self.together(choice)
        most = max(1, self.most // len(positions))
        remarks: list[str] = []
        points = [self._or_none(self._points, at, choice, most, remarks) for at in positions if choice.prior]
        sweeps = [self._or_none(self._sweep, at, choice, most, remarks) for at in positions if choice.sweeps]
        return Shown(join(points), join(sweeps), tuple(dict.fromkeys(remarks)))

    def _or_none(self, make: MakeCloud, position: int, choice: Choice, most: int, remarks: list[str]) -> Cloud:
        """Make a frame's points; where they cannot be made, add the reason to the remarks."""
        try:
            return make(position, choice, most)
        except DataError as error:
            remarks.append(str(error))
            return empty()

    def _points(self, position: int, choice: Choice, most: int) -> Cloud:
        """Back-project a prior's map."""
        frame, prior = self.frame(position), self.priors[str(choice.prior)]
        if not prior.depth_path(frame.id).exists():
            raise DataError(f"frame {frame.id}: {choice.prior} has no map of it")
        pose = self._pose(position)
        depth = prior.read(frame.id)
        picture, where = paint(frame, depth, choice.colouring)
        kept = where & sure_and_near(depth, choice.least_confidence, choice.farthest_m)
        return back_project(frame.camera, depth, kept, picture, pose, most)

    def _sweep(self, position: int, choice: Choice, most: int) -> Cloud:
        """Place a LiDAR sweep, the car's motion taken out."""
        frame, pose = self.frame(position), self._pose(position)
        sweep = frame.sweep()
        if sweep is None:
            raise DataError(f"frame {frame.id}: has no LiDAR sweep")
        if frame.T_cam_lidar is None:
            raise DataError(f"frame {frame.id}: the LiDAR's place is not known")
        return place(untwist(sweep), pose @ frame.T_cam_lidar, most)

    def _pose(self, position: int) -> Matrix:
        pose = self.track.pose(position)
        if pose is None:
            raise DataError(f"frame {self.track.ids[position]}: has no pose: it cannot be placed among the others")
        return pose


def spread(count: int, most: int) -> Sequence[int]:
    """Return at most `most` of `count` positions, evenly spread, the first and the last among them."""
    if count <= most:
        return range(count)
    return [round(i * (count - 1) / (most - 1)) for i in range(most)]
