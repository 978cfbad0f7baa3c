"""A sampled frame: what it and its neighbours in time show, read once for all that judges it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from priors.check.egomotion import SeenMotion, see_motion
from priors.codecs import as_grey
from priors.errors import DataError
from priors.geometry import convert_disparity, project, scatter_nearest, transform, untwist
from priors.pairs import matching
from priors.pairs.agreement import compare_sweep, match_corners
from priors.pairs.read import read_pair
from priors.types import Depth, FloatMap, Frame, Image, Input

Floats = npt.NDArray[np.float64]
Made = TypeVar("Made")
NEAREST_SWEEP_M = 1.0
"""Points of a sweep that are nearer hit the car itself."""


@dataclass
class Sample:
    """One frame of those whose files are read, and the frames before and after it in the drive."""

    frame: Frame
    before: Frame | None = None
    after: Frame | None = None
    trusts_stereo: bool = True
    """Whether the pair works: else what stereo sees is no evidence."""
    _distrusted: set[str] = field(default_factory=set)
    _read: dict[str, Any] = field(default_factory=dict)
    _errors: dict[str, str] = field(default_factory=dict)

    def read(self, what: Input) -> Any:
        """Read what the frame has, once; None where it has none, or it cannot be read: see `error`."""
        if what not in self._read:
            self._read[what] = None
            try:
                self._read[what] = self.frame.read(what) if self.frame.has(what) else None
            except DataError as error:
                self._errors[what] = str(error)
        return self._read[what]

    def error(self, what: Input) -> str | None:
        """Return why something cannot be read."""
        self.read(what)
        return self._errors.get(what)

    def look(self) -> None:
        """Read and compare everything now."""
        _ = self.corners, self.sweep_pairs, self.read("truth"), self.read("sparse"), self.follower

    @cached_property
    def grey(self) -> Image | None:
        """The image (height, width), grey."""
        image = self.read("image")
        return None if image is None else as_grey(image)

    @cached_property
    def follower(self) -> Image | None:
        """The image of the frame after (height, width), grey."""
        image = None if self.after is None else attempt(self.after.image)
        return None if image is None else as_grey(image)

    @cached_property
    def corners(self) -> Floats | None:
        """Where the image's corners lie in the other image: see `match_corners`."""
        return self.corners_in(self.frame)

    def corners_in(self, moment: Frame | None) -> Floats | None:
        """Find the image's corners in the other camera's image of a moment; None where there is none."""
        if self.grey is None or moment is None or not moment.has("other"):
            return None
        image = self.read("other") if moment is self.frame else attempt(moment.other)
        if image is None or image.shape[:2] != self.grey.shape:
            return None
        return match_corners(self.grey, as_grey(image), self.frame.side)

    @cached_property
    def stereo_px(self) -> FloatMap | None:
        """What a quick stereo match sees (height, width), px; 0 = no value."""
        if not self.frame.baseline_m or self.read("image") is None or self.read("other") is None:
            return None
        return attempt(lambda: read_pair(self.frame).match(matching.quick_match))

    @cached_property
    def stereo_m(self) -> FloatMap | None:
        """The same in metres."""
        if self.stereo_px is None or self.frame.baseline_m is None:
            return None
        return convert_disparity(self.stereo_px, self.frame.camera.fx, self.frame.baseline_m)

    @cached_property
    def sweep_m(self) -> FloatMap | None:
        """The sweep, projected (height, width), metres; 0 = no value."""
        sweep = self.read("sweep")
        if sweep is None or self.frame.T_cam_lidar is None:
            return None
        uv_px, depth_m = project(self.frame.camera, transform(self.frame.T_cam_lidar, untwist(sweep)))
        far = depth_m > NEAREST_SWEEP_M
        return scatter_nearest(uv_px[far], depth_m[far], self.frame.camera.size)

    @cached_property
    def sweep_pairs(self) -> Floats | None:
        """Disparities (n, 2) of the sweep's points and of stereo at them, px; None where either is missing."""
        sweep, stereo_px = self.read("sweep"), self.stereo_px
        return None if sweep is None or stereo_px is None else compare_sweep(self.frame, sweep, stereo_px)

    def map_m(self, what: Input) -> FloatMap | None:
        """Return a depth map of the data set (height, width), metres; None where there is none of that size."""
        depth: Depth | None = self.read(what)
        return None if depth is None or depth.depth_m.shape != self.frame.camera.size else depth.depth_m

    @cached_property
    def depths(self) -> dict[str, FloatMap]:
        """Every depth map of the frame (height, width), metres, by what made it; the surest first."""
        maps = {
            "stereo": self.stereo_m if self.trusts_stereo else None,
            "LiDAR": self.sweep_m,
            "truth": self.map_m("truth"),
            "sparse": self.map_m("sparse"),
        }
        return {name: map_m for name, map_m in maps.items() if map_m is not None and (map_m > 0).any()}

    def drop(self, what: str, value_m: float | None) -> None:
        """Take a number that stands for 'none' out of a kind of map."""
        if value_m is not None and what in self.depths:
            self.depths[what] = np.where(self.depths[what] == np.float32(value_m), np.float32(0), self.depths[what])

    def distrusts(self, what: str) -> bool:
        """Tell whether a kind of depth map was found wrong."""
        return what in self._distrusted

    def distrust(self, what: str) -> None:
        """Take a kind of depth map for no evidence of how the camera moves."""
        self._distrusted.add(what)
        self.__dict__.pop("seen_motion", None)

    @cached_property
    def seen_motion(self) -> SeenMotion | None:
        """How the camera moves to the frame after, as the images show it; None where they do not."""
        if self.grey is None or self.follower is None or self.follower.shape != self.grey.shape:
            return None
        evidence = {name: map_m for name, map_m in self.depths.items() if name not in self._distrusted}
        return see_motion(self.grey, self.follower, self.frame.camera, evidence)


def attempt(make: Callable[[], Made]) -> Made | None:
    """Run a function; None where it raises DataError, which has its own finding."""
    try:
        return make()
    except DataError:
        return None
