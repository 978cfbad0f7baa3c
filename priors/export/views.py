"""Views: the frames of a prior that are exported, each with its image, its pose and its filtered map."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from priors import origin
from priors.cache import Prior
from priors.codecs import as_rgb
from priors.errors import DataError
from priors.filters import Filters
from priors.origin import Offset
from priors.selection import select
from priors.types import Camera, Depth, Drive, Frame, Image, Matrix

NO_FILTERS = Filters()
PIXEL_CENTRE = 0.5
"""Where COLMAP and nerfstudio have the centre of the top-left pixel, along both axes; ours is 0."""


@dataclass(frozen=True)
class View:
    """One frame of an export."""

    number: int
    """Its place among the views, from 0."""
    frame: Frame
    depth: Depth
    """The prior's map, filtered."""
    name: str
    """What its files are called, without the ending."""

    @property
    def camera(self) -> Camera:
        """The frame's camera."""
        return self.frame.camera

    def rgb(self) -> Image:
        """Read the image: (height, width, 3)."""
        return as_rgb(self.frame.image())


@dataclass(frozen=True)
class Views:
    """The frames of a prior that are exported; maps and images are read when they are asked for.

    Iterating reads one view after another and leaves out those that cannot be read: `unread` tells. DataError where
    that is all of them.
    """

    prior: Prior
    drive: Drive
    ids: Sequence[str]
    """Frames that have a map, and a pose where one is needed."""
    filters: Filters = NO_FILTERS
    unread: dict[str, str] = field(default_factory=dict)
    """Frame id -> why its map could not be read; known once the views were read."""
    unplaced: dict[str, str] = field(default_factory=dict)
    """Frame id -> why it has no pose; such frames are left out where poses are needed."""

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[View]:
        for number, id_ in enumerate(self.ids):
            try:
                yield self.read(number)
            except DataError as error:
                self.unread[id_] = str(error)
        if len(self.unread) == len(self.ids):
            first = next(iter(self.unread))
            raise DataError(f"{self.prior.folder}: no frame can be exported, the first {first}: {self.unread[first]}")

    def read(self, number: int) -> View:
        """Read the view at a place; DataError where its map is missing, damaged or of another size."""
        frame = self.frames[number]
        depth = self.prior.read(frame.id)
        if depth.depth_m.shape != frame.camera.size:
            (rows, columns), (height, width) = depth.depth_m.shape, frame.camera.size
            found = f"the map is {columns}x{rows}, the camera {width}x{height}"
            raise DataError(f"{self.prior.depth_path(frame.id)}: {found}: build the prior again")
        return View(number, frame, self.filters(depth, frame), self.names[frame.id])

    @cached_property
    def frames(self) -> list[Frame]:
        """The views' frames, in the order of the drive."""
        places = {id_: index for index, id_ in enumerate(self.drive.ids)}
        return [self.drive[places[id_]] for id_ in self.ids]

    @cached_property
    def names(self) -> dict[str, str]:
        """What each frame's files are called: its id, white space as underscores, for formats that split at it."""
        plain = {id_: "_".join(id_.split()) for id_ in self.ids}
        return plain if len(set(plain.values())) == len(plain) else {id_: f"{n:06d}" for n, id_ in enumerate(self.ids)}

    @cached_property
    def T_world_cam(self) -> npt.NDArray[np.float64]:
        """Poses (n, 4, 4), camera to world, metres, in the drive's own frame."""
        return np.array([frame.pose() for frame in self.frames], dtype=np.float64)

    @cached_property
    def origin_m(self) -> Offset:
        """What programs that compute in float32 must take off a drive far from zero (priors/origin.py)."""
        return origin.origin_of(self.T_world_cam)

    @cached_property
    def near_poses(self) -> npt.NDArray[np.float64]:
        """Poses (n, 4, 4), camera to world less the origin, metres."""
        return origin.without(self.origin_m, self.T_world_cam)

    def pose(self, view: View) -> Matrix:
        """Return a view's pose (4, 4), camera to world less the origin, metres."""
        pose: Matrix = self.near_poses[view.number]
        return pose


def choose(prior: Prior, drive: Drive, frames: str | None, filters: Filters, posed: bool) -> Views:
    """Find the frames of a prior that can be exported.

    Args:
        prior: whose maps.
        drive: the one that the prior was made for.
        frames: only this range of frames, a:b; None: all.
        filters: what to leave out of the maps.
        posed: whether the frames must have poses; those that have none are left out.

    Raises:
        DataError: there is no map of these frames, or no frame has a pose, or a filter asks for what the drive lacks.
    """
    places = {drive.ids[index]: index for index in select(drive.ids, frames)}
    ids = [id_ for id_ in places if prior.depth_path(id_).exists()]
    if not ids:
        asked = "" if frames is None else f" in --frames {frames}"
        raise DataError(f"{prior.folder}: no maps of {drive.name}{asked}: build them first")
    for what in filters.reads:
        frame = drive[places[ids[0]]]
        if not frame.has(what):
            frame.read(what)  # raises with the drive's own reason
    unplaced = {}
    for id_ in ids if posed else []:
        try:
            drive[places[id_]].pose()
        except DataError as error:
            unplaced[id_] = str(error)
    if len(unplaced) == len(ids):
        raise DataError(f"{drive.name}: no frame has a pose, the first: {unplaced[ids[0]]}: this format needs poses")
    return Views(prior, drive, [id_ for id_ in ids if id_ not in unplaced], filters, unplaced=unplaced)
