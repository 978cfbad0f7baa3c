"""The few types that everything else leans on. Units and frames are in the names."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from eval.calibration import Tolerance
from priors.errors import DataError

Image: TypeAlias = npt.NDArray[np.uint8]
"""uint8, (height, width, 3) RGB or (height, width) grey."""
FloatMap: TypeAlias = npt.NDArray[np.float32]
Mask: TypeAlias = npt.NDArray[np.bool_]
Matrix: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Camera:
    """A rectified pinhole camera with OpenCV axes: x right, y down, z forward."""

    K: Matrix
    """(3, 3), pixels; the centre of the top-left pixel is (0, 0), as OpenCV and KITTI have it."""
    size: tuple[int, int]
    """(height, width), pixels."""

    @property
    def fx(self) -> float:
        """Focal length along x, pixels."""
        return float(self.K[0, 0])


@dataclass(frozen=True, slots=True)
class Depth:
    """A depth map: what every method returns and the cache stores. A notebook shows it as a picture."""

    depth_m: FloatMap
    """(height, width) float32, distance along the camera's z axis in metres; 0 = no value."""
    confidence: FloatMap | None = None
    """(height, width) float32 in [0, 1], 0 where depth_m is 0; None where the method has none."""
    consistency: FloatMap | None = None
    """(height, width) float32 in [0, 1]: a second confidence, how well the neighbouring frames' maps agree; None where
    nobody compared them."""
    within_5_percent: FloatMap | None = None
    """(height, width) float32 in [0, 1]: the probability that the depth is right within 5 % of it, 0 where depth_m is
    0; None where the method cannot tell."""

    def __repr__(self) -> str:
        """Tell size and values in a line: the arrays themselves are long."""
        size = "x".join(str(length) for length in self.depth_m.shape[::-1])
        told = f"{size}, no value"
        if self.valid.any():
            near_m, middle_m, far_m = np.percentile(self.depth_m[self.valid], (0, 50, 100))
            values = f"{near_m:.1f} to {far_m:.1f} m, median {middle_m:.1f} m"
            told = f"{size}, {self.density:.1%} of the pixels have {values}"
        return f"Depth({told}{'' if self.confidence is None else ', with confidence'})"

    def _repr_html_(self) -> str:
        """Show the map in a notebook; drawing lies below the types, so it is asked at the package's front door."""
        import priors

        return priors.depth_html(self)

    @property
    def valid(self) -> Mask:
        """True where there is a value."""
        return self.depth_m > 0

    @property
    def density(self) -> float:
        """Share of the pixels that have a value, in [0, 1]."""
        return float(np.mean(self.valid)) if self.depth_m.size else 0.0

    def trust(self) -> FloatMap:
        """Return the confidence (height, width); DataError where the map has none."""
        if self.confidence is None:
            raise DataError("this depth map has no confidence: choose a method that has one")
        return self.confidence

    def keep(self, mask: Mask) -> "Depth":
        """Return the map with everything outside mask (height, width) made invalid."""
        kept = [
            None if part is None else np.where(mask, part, np.float32(0))
            for part in (self.confidence, self.consistency, self.within_5_percent)
        ]
        return Depth(np.where(mask, self.depth_m, np.float32(0)), *kept)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One rotation of a LiDAR, in the LiDAR's own frame (x forward, y left, z up)."""

    xyz_m: npt.NDArray[np.float32]
    """(n, 3) metres."""
    T_world_lidar: Matrix | None
    """(4, 4) pose at the sweep's reference time; None where the drive has no poses, or where they break
    between the frame that asks and the sweep (priors/motion.py)."""
    time_s: npt.NDArray[np.float32] | None = None
    """(n,) seconds from the reference time to each point's own; None: motion is already compensated."""
    velocity: Matrix | None = None
    """(6,) ego motion in the LiDAR's frame at the reference time: m/s, then rad/s; None where unknown."""


@dataclass(frozen=True, slots=True)
class Rig:
    """A car, and the usual error of its stereo pairs' rectification; see priors/pairs/rectification.py."""

    name: str
    focal_px: float
    """Focal length of the images on which the error was measured, px."""
    shift_px: float
    tilt_px: float
    yaw_px: float
    pitch_px: float
    scale: float
    """Calibrated over true baseline."""


Input: TypeAlias = Literal["image", "other", "sweep", "truth", "sparse", "sky", "foreground"]
"""What a frame may have, and a method or a filter may need."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One moment of a drive as one camera sees it; files are read when asked for, not before."""

    id: str
    """The data set's own frame id: file stem, e.g. 0000000005. What caches and truth are joined by."""
    camera: Camera
    readers: Mapping[str, Callable[..., Any]]
    """What can be read, by the names of Input. Each is called only when needed."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Why a reader is not there and what to do, one line each; under "pose", why a pose that should be there is not;
    under "poses", why the drive has none, or none here."""
    T_world_cam: Matrix | None = None
    """(4, 4) camera to world, metres."""
    T_cam_lidar: Matrix | None = None
    """(4, 4) LiDAR to camera, metres."""
    posed: Literal["camera", "lidar"] = "camera"
    """Whose poses the drive has; those of the other follow by T_cam_lidar."""
    time_s: float | None = None
    """Seconds since the drive's first frame."""
    baseline_m: float | None = None
    """Distance to the other camera of the stereo pair, metres, > 0."""
    side: Literal["left", "right"] = "left"
    """Which eye of the pair this camera is."""
    rig: Rig | None = None
    """The car that took it, where the error of its rectification is known."""
    files: Mapping[str, Callable[..., Path | None]] = field(default_factory=dict)
    """Which file a reader reads when it is called with the same arguments; None where the drive has no such file.
    `sweep.times` is another file that the reader `sweep` reads, whatever its arguments.
    A reader that is not listed is not watched: a changed file of it is not noticed."""

    def __repr__(self) -> str:
        """Tell in a line what the frame has."""
        height, width = self.camera.size
        has = [*self.readers, *(["pose"] if self.T_world_cam is not None else [])]
        return f"Frame({self.id}, {width}x{height}, with {', '.join(has)})"

    def has(self, what: Input) -> bool:
        """Tell whether it can be read here."""
        return what in self.readers

    def read(self, what: Input, *args: Any) -> Any:
        """Read `what`, or raise DataError with the drive's reason why it is not there."""
        if what not in self.readers:
            raise DataError(f"frame {self.id}: {self.missing.get(what, f'this drive has no {what}')}")
        return self.readers[what](*args)

    def pose(self) -> Matrix:
        """Return T_world_cam, or raise DataError with the drive's reason why it is not known."""
        if self.T_world_cam is None:
            raise DataError(f"frame {self.id}: {self.why_unplaced()}")
        return self.T_world_cam

    def why_unplaced(self) -> str:
        """Say why the frame has no pose, and what to do."""
        return self.missing.get("pose") or self.missing.get("poses", "it has no pose")

    def image(self) -> Image:
        """Read this camera's image: uint8 (h, w, 3) RGB, or (h, w) where the camera is grey."""
        return self.read("image")

    def other(self) -> Image:
        """Read the image of the pair's other camera, same moment, same shape."""
        return self.read("other")

    def sweep(self, offset: int = 0) -> Sweep | None:
        """Read the LiDAR sweep `offset` frames from this one; None where the drive misses that one.

        Raises DataError where the drive has no LiDAR at all, or the file is damaged.
        """
        return self.read("sweep", offset)

    def truth(self) -> Depth:
        """Read the true depth, sparse where the data set's is."""
        return self.read("truth")

    def sparse(self) -> Depth:
        """Read the data set's own sparse depth map (KITTI velodyne_raw): completion's input."""
        return self.read("sparse")

    def sky(self) -> Mask:
        """Read the true sky mask, where the data set knows it."""
        return self.read("sky")

    def foreground(self) -> Mask:
        """Read which pixels are objects that move by themselves, where the data set scores them apart."""
        return self.read("foreground")


@dataclass(frozen=True, slots=True)
class Earlier:
    """A frame whose map was made before, and the map as its method left it: what the next frame's may be made of."""

    frame: Frame
    depth: Depth


class Drive(Protocol):
    """A lazily read sequence of frames from one camera."""

    @property
    def name(self) -> str:
        """Folder name in the cache."""
        ...

    @property
    def ids(self) -> Sequence[str]:
        """Frame ids in time order."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records and `open_drive` needs to open it again."""
        ...

    def fingerprint(self) -> str:
        """Return a digest of calibration, poses and the first image: part of a cache's key."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...


@dataclass(frozen=True)
class Method(ABC):
    """A way to make depth: a frozen dataclass whose fields are flags, cache key and record.

    A subclass must have `reads`, `resolve` and `__call__`; the rest has defaults that suit most.
    """

    VERSION: ClassVar[int] = 1
    """Part of the cache's key: raised when the method's maps change, and only then. Rounding is no change."""
    JOINS: ClassVar[bool] = False
    """Whether it joins the maps of other methods: a bench measures those, and nothing chooses it unasked."""

    @property
    def name(self) -> str:
        """What flags, folders and tables call it: the class's name in snake case, which is also its file's."""
        return re.sub(r"(?<=.)(?=[A-Z])", "_", type(self).__name__).lower()

    @property
    @abstractmethod
    def reads(self) -> tuple[Input, ...]:
        """What a frame must have for this method to work on it."""

    @abstractmethod
    def resolve(self, frame: Frame) -> Self:
        """Return the config with every 'auto' decided from the drive's first frame."""

    @abstractmethod
    def __call__(self, frame: Frame) -> Depth:
        """Make the frame's depth map."""

    @property
    def measures(self) -> bool:
        """Whether `resolve` measures something in the frame's files, and asks this machine nothing: it is kept."""
        return False

    @property
    def sure_within(self) -> Tolerance | None:
        """The error up to which a value is right, where the confidence is the probability of that; None: it is not."""
        return None

    @property
    def carries(self) -> bool:
        """Whether `carry_on` can make a frame's map of the one before."""
        return False

    def carry_on(self, frame: Frame, before: Earlier) -> Depth | None:
        """Make a frame's map of the frame's before; None where it must be made whole."""
        return None

    def unread(self) -> Mapping[str, str]:
        """Return the fields that these settings leave without effect, each with the settings that would read it.

        The command line tells who sets one of them: {"size": "--stereo.model cfnet or pcwnet"}.
        """
        return {}

    def weights_digest(self) -> str | None:
        """Return the hash of the learned weights, for the cache's key; None where there are none."""
        return None

    def notes(self) -> list[str]:
        """Return what a user should know before the first frame, a line each."""
        return []

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        """Look at the whole drive, once and before the first frame; returns what makes a frame's depth.

        Args:
            drive: what the frames will come from.
            folder: where to keep what was learned from the drive.
            on_note: told what is going on, a line at a time.
        """
        return self
