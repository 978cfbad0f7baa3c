"""A drive as one camera sees it: what the readers of all data sets share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Literal, overload

from priors import codecs
from priors.drive_around import Stretch, tell
from priors.drives._files import check_baseline, check_size, digest, read_sized
from priors.drives._links import plain
from priors.errors import DataError, UsageError
from priors.types import Camera, Depth, FloatMap, Frame, Image, Matrix, Rig

BY_FRAME = "by frame"
"""What the description of a drive whose frames have cameras of their own says under `cameras`."""
Readers = dict[str, Callable[..., Any]]
Files = dict[str, Callable[..., Path | None]]


class CameraDrive(ABC):
    """A folder's frames from one camera.

    A data set's reader sets the fields below in its `__init__`, and gives what its frames have beyond images and maps
    by the methods that it overrides. Frame ids are the keys of `images`, in time order.
    """

    pairs: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Left and right camera of each rectified stereo pair of the data set."""
    usual_camera: ClassVar[str] = ""
    """The camera that the drive's name does not mention."""
    posed: ClassVar[Literal["camera", "lidar"]] = "camera"
    """Whose poses the data set has; those of the other follow by the place of the LiDAR."""

    images: Mapping[str, Path]
    """Frame id -> image file."""
    others: Mapping[str, Path]
    """Frame id -> image file of the pair's other camera; empty without one."""
    maps: Mapping[str, Mapping[str, Path]]
    """truth and sparse -> frame id -> depth map, metres; see codecs.read_float_map."""
    camera: Camera
    """Of the images as the frames show them; of the first image where they differ: see `camera_of`."""
    baseline_m: float | None
    """Distance to the pair's other camera, metres, > 0; of the first pair where they differ: see `baseline_of`."""
    rig: Rig | None
    """The car, where the error of its rectification is known."""

    def __init__(self, folder: Path, camera_name: str, truth: Path | None = None) -> None:
        self.folder, self.camera_name, self.truth = plain(folder), camera_name, None if truth is None else plain(truth)
        self.others, self.maps, self.baseline_m, self.rig = {}, {}, None, None

    @property
    def name(self) -> str:
        """The folder's name, and the camera's unless it is the usual one."""
        folder = self.folder.name or "root"  # of the disk
        return folder if self.camera_name == self.usual_camera else f"{folder}-{self.camera_name}"

    @cached_property
    def ids(self) -> Sequence[str]:
        """Frame ids in time order."""
        return list(self.images)

    @property
    def partner(self) -> str | None:
        """The pair's other camera; None for a camera of no pair."""
        names = next((names for names in self.pairs if self.camera_name in names), None)
        return None if names is None else names[1 - names.index(self.camera_name)]

    @property
    def side(self) -> Literal["left", "right"]:
        """Which eye of the pair this camera is; left for a camera of no pair."""
        return "right" if any(self.camera_name == right for _, right in self.pairs) else "left"

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records and `reopen` needs."""
        truth = None if self.truth is None else str(self.truth.resolve())
        dataset = type(self).__module__.rpartition(".")[2]
        return {"dataset": dataset, "path": str(self.folder.absolute()), "camera": self.camera_name, "truth": truth}

    def fingerprint(self) -> str:
        """Digest the first image and what places the images: calibration and poses."""
        return digest([*self.sources(), self.images[self.ids[0]]])

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, for the audit; a kind without files is not missed."""
        return {"other": list(self.others), **{what: list(paths) for what, paths in self.maps.items()}}

    def notes(self) -> list[str]:
        """Say what was done to the images or decided about the camera, for the audit, a line each."""
        return []

    def camera_of(self, id_: str) -> Camera:
        """Return a frame's camera; a drive whose frames differ overrides it, and has BY_FRAME in its description."""
        return self.camera

    def baseline_of(self, id_: str) -> float | None:
        """Return the baseline of a frame's pair, metres."""
        return self.baseline_m

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return tell(self)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> Stretch: ...

    def __getitem__(self, index: int | slice) -> Frame | Stretch:
        return Stretch(self, range(len(self))[index]) if isinstance(index, slice) else self._frame(index)

    def _frame(self, index: int) -> Frame:
        id_ = self.ids[index]
        missing, readers = dict(self.missing(id_)), self.readers(id_)
        T_world_cam = T_cam_lidar = None
        try:
            T_world_cam = self.T_world_cam(id_)
        except DataError as error:  # refused is only what needs the pose
            missing["pose"] = str(error)
        try:
            T_cam_lidar = self.T_cam_lidar(id_)
        except DataError as error:  # or the sweep
            missing["sweep"] = str(error)
            readers.pop("sweep", None)
        return Frame(
            id=id_,
            camera=self.camera_of(id_),
            readers=readers,
            missing=missing,
            T_world_cam=T_world_cam,
            T_cam_lidar=T_cam_lidar,
            posed=self.posed,
            time_s=self.time_s(id_),
            baseline_m=self.baseline_of(id_),
            side=self.side,
            rig=self.rig,
            files=self.files(id_),
        )

    @abstractmethod
    def sources(self) -> list[Path]:
        """List the files of calibration and poses."""

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame (see Frame.readers), each by a function that reads files when called."""
        readers: Readers = {"image": partial(self.read_image, self.images[id_], id_)}
        if id_ in self.others:
            readers["other"] = partial(self.read_image, self.others[id_], id_)
        for what, paths in self.maps.items():
            if id_ in paths:
                readers[what] = partial(self.read_map, paths[id_], id_)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader of a frame reads (see Frame.files); also of what is not there."""
        files: Files = {"image": partial(self.images.get, id_), "other": partial(self.others.get, id_)}
        return files | {what: partial(paths.get, id_) for what, paths in self.maps.items()}

    def missing(self, id_: str) -> dict[str, str]:
        """Say of what a frame lacks why it is not there and what to do, one line each."""
        return {}

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return a frame's pose (4, 4), metres; None where the drive has none."""
        return None

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Return the LiDAR's place (4, 4) at a frame, metres; None without a LiDAR."""
        return None

    def time_s(self, id_: str) -> float | None:
        """Return seconds since the drive's first frame; None where they are not known."""
        return None

    def read_image(self, path: Path, id_: str) -> Image:
        """Read an image of a frame, which must have its camera's size."""
        return read_sized(path, self.camera_of(id_))

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read a depth map of a frame, which must have its camera's size."""
        return Depth(check_size(codecs.read_float_map(path), path, self.camera_of(id_)))

    def shown_map(self, values: FloatMap, id_: str) -> FloatMap:
        """Return a map (height, width) of a frame's image as it is stored, as the frame shows the image."""
        return values

    def paired_camera(self) -> str:
        """Return the pair's other camera, for data sets whose cameras all have one; else UsageError names them."""
        if self.partner is None:
            names = ", ".join(name for pair in self.pairs for name in pair)
            raise UsageError(f"{self.folder}: no camera {self.camera_name!r}: choose one of {names}")
        return self.partner

    def baseline(self, partner_right_m: float, calibration: Path) -> float:
        """Return the baseline of a pair whose other camera stands partner_right_m to the right of this one, metres."""
        baseline_m = partner_right_m if self.side == "left" else -partner_right_m
        return check_baseline(baseline_m, f"from {self.camera_name} to {self.partner}", calibration)
