"""Fusion: the maps of many views become one point cloud. A voxel has one point, which knows the views that see it.

In a voxel the pixel that is seen from nearest is the point: its position is what that view's map says, and nothing is
averaged. The other views' pixels in the voxel are its observations: a track, as COLMAP has it.

Where there are more voxels than points are wanted, those with the least hash are kept: each is as likely as any other,
and a voxel that goes never comes back, so that the memory does not grow with the drive (bottom-k sampling, Cohen and
Kaplan, PODC 2007).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.errors import DataError, expect, expect_between
from priors.export.ply import Points
from priors.export.views import View
from priors.geometry import rays
from priors.types import Matrix

Step = Callable[[], None]
"""Called when a view is done."""
SEEN = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
        ("confidence", "<f4"), ("depth", "<f4"), ("views", "<i4"),
    ]
)  # fmt: skip
"""A point: metres; its colour; the confidence of its map there, 1 where the map has none; the depth from which it was
seen, metres; how many views see its voxel."""
MOST_POINTS = 10**9
USUAL_VIEWS = 2
MODEL_POINTS = 200_000
"""Points where --points says nothing, for programs that start from them: what structure from motion gives."""
_AT_ONCE = 1_000_000
"""Points that wait before they are merged: merging after each view would sort all of them each time."""
_SPARE = 8
"""Voxels kept for each point that is wanted, where most of them may be seen by too few views."""


@dataclass(frozen=True)
class FusionConfig:
    """Which pixels become points."""

    voxel_m: float = 0.1
    """One point in a cube of this side, metres: the pixel seen from nearest."""
    reach_m: float = 60.0
    """Largest camera-z depth of a point, metres: far depth is rough."""
    views: int | None = None
    """Least number of frames that must see a voxel. Default: 2, since much of what one map alone says is wrong; 1 where
    no voxel is seen by two."""
    points: int | None = None
    """Most points, drawn evenly. Default: 200,000; 1,000,000 for ply."""

    def __post_init__(self) -> None:
        expect(0 < self.voxel_m < float("inf"), "--voxel-m", self.voxel_m, "metres, more than 0")
        expect(self.reach_m > 0, "--reach-m", self.reach_m, "metres, more than 0")
        expect_between(1, self.views, MOST_POINTS, "--views")
        expect_between(1, self.points, MOST_POINTS, "--points")


@dataclass(frozen=True)
class Observations:
    """What one view sees of the cloud."""

    point: npt.NDArray[np.int64]
    """(n,) places in the cloud."""
    uv_px: npt.NDArray[np.float32]
    """(n, 2) the pixel in which each is seen; the centre of the top-left pixel is (0, 0)."""


@dataclass(frozen=True)
class Cloud:
    """Fused views."""

    points: Points
    """(n,) SEEN, metres, in the frame of the poses."""
    seen_by: dict[int, Observations]
    """A view's number -> what it sees."""
    least_views: int
    """So many views see each point, or more."""

    def xyz_m(self) -> npt.NDArray[np.float64]:
        """Return the positions (n, 3), metres."""
        return np.stack([self.points[axis].astype(np.float64) for axis in "xyz"], axis=1)

    def rgb(self) -> npt.NDArray[np.uint8]:
        """Return the colours (n, 3)."""
        return np.stack([self.points[name] for name in ("red", "green", "blue")], axis=1)


def fuse(
    views: Iterable[View], T_world_cam: npt.NDArray[np.float64], config: FusionConfig, most: int = MODEL_POINTS
) -> Cloud:
    """Fuse views.

    Args:
        views: read one after another.
        T_world_cam: (n, 4, 4) the pose of each view by its number, metres; near zero, since points are float32.
        config: which pixels become points.
        most: most points of the cloud where the config says nothing.

    Raises:
        DataError: no pixel becomes a point.
    """
    count = most if config.points is None else config.points
    merged, pixels = _Merged(count if config.views == 1 else count * _SPARE), {}
    for view in views:
        cells, points, flat = _view_points(view, T_world_cam[view.number], config)
        taken = merged.add(cells, points)
        pixels[view.number] = cells[taken], flat[taken].astype(np.int32), view.camera.size[1]
    cells, points = merged.finish()
    least_views = config.views
    if least_views is None:
        least_views = min(USUAL_VIEWS, int(points["views"].max(initial=1)))
    enough = points["views"] >= least_views
    cells, points = least(cells[enough], points[enough], count)
    if not len(points):
        told = f"no point within {config.reach_m:g} m" + (f" that {least_views} views see" if least_views > 1 else "")
        raise DataError(f"{told}: choose another --reach-m, --views or --voxel-m, or filter less")
    seen_by = {number: _observations(cells, *seen) for number, seen in pixels.items()}
    return Cloud(points, seen_by, least_views)


def hash_of(cells: npt.NDArray[np.int64]) -> npt.NDArray[np.uint64]:
    """Return an even 64-bit hash of each number (n,): the finaliser of SplitMix64 (Steele et al., OOPSLA 2014)."""
    mixed = cells.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))


def least(cells: npt.NDArray[np.int64], points: Points, count: int) -> tuple[npt.NDArray[np.int64], Points]:
    """Return the `count` cells with the least hash, in the order given, and their points."""
    if len(cells) <= count:
        return cells, points
    hashes = hash_of(cells)
    kept = hashes <= np.partition(hashes, count - 1)[count - 1]
    return cells[kept], points[kept]


def cells_of(points: Points, voxel_m: float) -> npt.NDArray[np.int64]:
    """Number the voxel of each point (n,): 21 bits an axis, so cells repeat after 2^21 of them, 200 km of 0.1 m."""
    number = np.zeros(len(points), dtype=np.int64)
    for name in "xyz":
        number = (number << 21) | (np.floor(points[name] / voxel_m).astype(np.int64) & ((1 << 21) - 1))
    return number


def nearest(cells: npt.NDArray[np.int64], depth_m: npt.NDArray[np.floating]) -> npt.NDArray[np.int64]:
    """Return the places, ascending, of the least depth in each cell; the first of equal ones."""
    order = np.lexsort((depth_m, cells))
    first = np.ones(len(order), dtype=bool)
    first[1:] = cells[order[1:]] != cells[order[:-1]]
    return np.sort(order[first])


class _Merged:
    """Points of several views, one a cell: what was merged, and what waits. At most so many cells are kept."""

    def __init__(self, most: int) -> None:
        self.most, self.largest = most, np.uint64(2**64 - 1)
        self.cells, self.points = np.zeros(0, np.int64), np.zeros(0, SEEN)
        self.waiting: list[tuple[npt.NDArray[np.int64], Points]] = []

    def add(self, cells: npt.NDArray[np.int64], points: Points) -> npt.NDArray[np.bool_]:
        """Add a view's points (n,), no two in one cell; returns which of them may be kept (n,)."""
        taken: npt.NDArray[np.bool_] = hash_of(cells) <= self.largest
        self.waiting.append((cells[taken], points[taken]))
        if sum(len(cells) for cells, _ in self.waiting) > max(_AT_ONCE, len(self.cells)):
            self._merge()
        return taken

    def finish(self) -> tuple[npt.NDArray[np.int64], Points]:
        """Return the cells (n,), ascending, and their points (n,)."""
        self._merge()
        return self.cells, self.points

    def _merge(self) -> None:
        cells = np.concatenate([self.cells, *(cells for cells, _ in self.waiting)])
        points = np.concatenate([self.points, *(points for _, points in self.waiting)])
        self.waiting.clear()
        order = np.lexsort((points["depth"], cells))
        cells, points = cells[order], points[order]
        first = np.flatnonzero(np.diff(cells, prepend=cells[:1] - 1)) if len(cells) else np.zeros(0, np.int64)
        counts = np.add.reduceat(points["views"].astype(np.int64), first) if len(first) else np.zeros(0, np.int64)
        self.cells, self.points = cells[first], points[first]
        self.points["views"] = counts
        self.cells, self.points = least(self.cells, self.points, self.most)
        if len(self.cells) == self.most:
            self.largest = hash_of(self.cells).max()


def _view_points(
    view: View, T_world_cam: Matrix, config: FusionConfig
) -> tuple[npt.NDArray[np.int64], Points, npt.NDArray[np.int64]]:
    """Return a view's points, one a cell: cells (n,), ascending, points (n,) SEEN, and the flat pixels (n,)."""
    depth_m = view.depth.depth_m.reshape(-1)
    flat = np.flatnonzero((depth_m > 0) & (depth_m <= config.reach_m))
    xyz_m = rays(view.camera).reshape(-1, 3)[flat] * depth_m[flat, None]
    xyz_m = xyz_m @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    points = np.zeros(len(flat), SEEN)
    for axis, name in enumerate("xyz"):
        points[name] = xyz_m[:, axis]
    colours = view.rgb().reshape(-1, 3)[flat]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = colours[:, channel]
    confidence = view.depth.confidence
    points["confidence"] = 1 if confidence is None else confidence.reshape(-1)[flat]
    points["depth"], points["views"] = depth_m[flat], 1
    cells = cells_of(points, config.voxel_m)
    own = nearest(cells, points["depth"])
    own = own[np.argsort(cells[own], kind="stable")]
    return cells[own], points[own], flat[own]


def _observations(
    kept: npt.NDArray[np.int64], cells: npt.NDArray[np.int64], flat: npt.NDArray[np.int32], width: int
) -> Observations:
    """Return which of the kept cells (ascending) a view sees, and in which pixels."""
    place = np.minimum(np.searchsorted(kept, cells), len(kept) - 1)
    there = kept[place] == cells
    uv_px = np.stack([flat[there] % width, flat[there] // width], axis=1).astype(np.float32)
    return Observations(place[there], uv_px)
