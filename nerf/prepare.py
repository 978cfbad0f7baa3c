"""Scene preparation: a drive's frames and a prior's maps are copied into files once, and shared by all runs on them.

<folder>/<drive>-<digest>/images.npy         uint8 (frames, height, width, 3)
                         /frames.json        ids, camera, poses
                         /<prior>/depth.npy  float32 (frames, height, width), metres, 0 = no value
                         /<prior>/weight.npy uint8 (frames, height, width), confidence x 255; where there is one
                         /<prior>/sky1.npy   uint8 (frames, height, width), 1 = sky; 1: version of the sky's mask
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from nerf.guide import Guide, Maps, maps_of
from nerf.rate import Rate
from nerf.scene import Scene
from nerf.split import check_views, split
from nerf.stack import Stack, StackWriter
from priors import origin
from priors.errors import DataError
from priors.filters import Filters
from priors.machine import disk
from priors.motion import trajectory
from priors.origin import Offset
from priors.selection import parse_range, range_of, select
from priors.sky import VERSION, sky_mask
from priors.types import Camera, Drive

SURE = 128
"""Confidence x 255 from which on a value is right rather than wrong: there is no sky, whatever the image shows."""
RGB_BYTES, MAP_BYTES = 3, 4 + 1 + 1 + 2
"""What a pixel takes: its colour; its depth, confidence and sky, and two rounds of the check (nerf/evidence)."""
WHAT = "the scene's files"
ProgressBar: TypeAlias = Callable[[str, int], AbstractContextManager[Callable[..., None]]]
"""Opens a progress bar of a label and a number of frames; yields what is called after each."""


@dataclass(frozen=True)
class SceneConfig:
    """Which of a drive's frames a scene has, and what its prior passes before it is used."""

    views: str = "dense"
    """Training views: dense, sparse or a number."""
    frames: str | None = None
    """Range of frames, a:b; None: all."""
    filters: Filters = field(default_factory=Filters)
    """Thin the prior's maps once more, without another cache."""
    sparse_step: int | None = None
    """Every so many-th of the frames that are not held out is a sparse view; None: as the drive's rate has it."""

    def __post_init__(self) -> None:
        check_views(self.views)
        parse_range(self.frames)

    def parts(self, drive: Drive, positions: list[int]) -> tuple[list[int], list[int]]:
        """Part the frames at some positions of a drive into training and held-out ones, by their places among them."""
        step = self.sparse_step or Rate.of(drive, positions).sparse_step
        return split(len(positions), self.views, step)


def silent(label: str, count: int) -> AbstractContextManager[Callable[..., None]]:
    """Show no progress."""
    return nullcontext(lambda: None)


def open_scene(
    drive: Drive,
    prior: Guide | None,
    config: SceneConfig,
    folder: Path,
    progress: ProgressBar = silent,
    origin_m: Offset | None = None,
) -> Scene:
    """Prepare a drive and a prior for training in a folder, or open what was prepared there before.

    Args:
        drive: its frames.
        prior: its maps, or the drive's true ones; None: colours alone.
        config: which frames, and what the prior passes.
        folder: where the arrays are kept.
        progress: shows what is prepared.
        origin_m: what a run that goes on took off the positions; None: chosen for these frames (priors/origin.py).

    Raises:
        DataError: frames lack poses, poses jump, or the prior was made for another drive or camera, or has no frame
            or no value in common with the training frames; or the disk is too small.
    """
    positions = select(drive.ids, config.frames)
    train, test = config.parts(drive, positions)
    preparation = _Preparation(drive, positions, config.filters, folder, progress)
    copied = None if prior is None else preparation.copied(maps_of(prior, drive), test)
    disk.expect_room(folder, preparation.missing_bytes(copied), WHAT)
    record = preparation.images()  # after what does not fit is told
    depth_m, weight = (None, None) if copied is None else copied.maps()
    if depth_m is not None and copied is not None and not any((depth_m[position] > 0).any() for position in train):
        lack = f"no value in any of the {len(train)} training frames"
        raise DataError(f"{copied.source.told}: {lack}: build or filter it anew")
    camera, poses = Camera(np.array(record["K"]), tuple(record["size"])), np.array(record["T_world_cam"])
    images = Stack(preparation.home / "images.npy")
    origin_m = origin.origin_of(poses) if origin_m is None else origin_m
    poses = origin.without(origin_m, poses)
    sky = None if copied is None else copied.sky()
    guessed = copied is not None and copied.source.guesses
    arrays = images, depth_m, weight
    return Scene(drive.name, preparation.ids, camera, poses, *arrays, train, test, origin_m, sky, guessed=guessed)


def disk_told(drive: Drive, prior: Guide | None, config: SceneConfig, folder: Path) -> str | None:
    """Return the line that says what disk `open_scene` is going to take; None where that is little."""
    preparation = _Preparation(drive, select(drive.ids, config.frames), config.filters, folder, silent)
    _, test = config.parts(drive, preparation.positions)
    copied = None if prior is None else preparation.copied(maps_of(prior, drive), test)
    return disk.told(folder, preparation.missing_bytes(copied), WHAT)


def is_prepared(drive: Drive, config: SceneConfig, folder: Path) -> bool:
    """Tell whether these frames of just this drive, by its fingerprint, were copied into the folder before."""
    try:
        positions = select(drive.ids, config.frames)
    except DataError:
        return False
    return _Preparation(drive, positions, config.filters, folder, silent).home.is_dir()


@dataclass(frozen=True)
class _Preparation:
    """The frames at `positions` of a drive, on their way into files."""

    drive: Drive
    positions: list[int]
    filters: Filters
    folder: Path
    progress: ProgressBar

    @property
    def ids(self) -> list[str]:
        """The frames' ids."""
        return [self.drive.ids[position] for position in self.positions]

    @property
    def home(self) -> Path:
        """The folder of these frames of this drive."""
        return self.folder / f"{self.drive.name}-{_digest(self.drive.fingerprint(), *self.ids)}"

    def missing_bytes(self, copied: "_Copied | None") -> int:
        """Return how many bytes the files take that are not there: of the images, and of a prior's maps and check."""
        height, width = self.drive[self.positions[0]].camera.size
        pixel = 0 if (self.home / "frames.json").exists() else RGB_BYTES
        if copied is not None and not (copied.place / "depth.npy").exists():
            pixel += MAP_BYTES
        return pixel * len(self.positions) * height * width

    def images(self) -> dict[str, Any]:
        """Write images and poses unless they are there; the record is written last and marks them as done."""
        path = self.home / "frames.json"
        if not path.exists():
            poses, camera = self._poses(), self.drive[self.positions[0]].camera
            files = StackWriter(self.home / "images.npy", (len(self.positions), *camera.size, 3), np.uint8)
            with files as images, self.progress(f"images of {self.drive.name}", len(self.positions)) as step:
                for position in self.positions:
                    image = self.drive[position].image()
                    images.add(image if image.ndim == 3 else image[..., None])
                    step()
            record = {"ids": self.ids, "K": camera.K.tolist(), "size": camera.size, "T_world_cam": poses.tolist()}
            write_bytes(path, json.dumps(record).encode())
        return json.loads(path.read_text(encoding="utf-8"))

    def copied(self, source: Maps, test: Sequence[int]) -> "_Copied":
        """Return a prior's maps on their way into files; DataError where it does not fit.

        Args:
            source: the prior's maps.
            test: positions of the held-out frames among these.
        """
        ids = self.ids
        return _Copied(self, source, source.stamps(ids, [ids[position] for position in test]))

    def _poses(self) -> npt.NDArray[np.float64]:
        """Collect the poses; DataError where one is missing, not finite, or where they break."""
        name, poses = self.drive.name, []
        for position in self.positions:
            frame = self.drive[position]
            if frame.T_world_cam is None and "pose" in frame.missing:
                raise DataError(f"{name}: frame {frame.id} has no pose: {frame.missing['pose']}")
            if frame.T_world_cam is None or not np.isfinite(frame.T_world_cam).all():
                raise DataError(
                    f"{name}: frame {frame.id} has no pose: a field needs poses (`priors check` tells more)"
                )
            poses.append(frame.T_world_cam)
        self._expect_unbroken(np.array(poses))
        return np.array(poses)

    def _expect_unbroken(self, poses: npt.NDArray[np.float64]) -> None:
        """Raise DataError, with the longest part, where the path of the poses (n, 4, 4) breaks."""
        ids, path = self.ids, trajectory(self.drive)
        first, end = path.longest(ids)
        if end - first == len(ids):
            return
        cut = next(n for n in range(1, len(ids)) if path.broken(ids[n - 1], ids[n]))
        moved_m = float(np.linalg.norm(poses[cut, :3, 3] - poses[cut - 1, :3, 3]))
        part = range_of(self.drive.ids, self.positions[first], self.positions[end - 1] + 1)
        raise DataError(
            f"{self.drive.name}: the pose jumps {moved_m:.1f} m from frame {ids[cut - 1]} to {ids[cut]}, and a field "
            f"needs one path: use --frames {part}, its longest part ({end - first} of {len(ids)} frames)"
        )


@dataclass(frozen=True)
class _Copied:
    """A prior's filtered maps of the frames of a preparation."""

    frames: _Preparation
    source: Maps
    stamps: dict[str, str]
    """What tells apart the maps of the frames that have one, by frame id."""

    @property
    def place(self) -> Path:
        """The folder of the filtered maps."""
        filters = json.dumps(self.frames.filters.record())
        return self.frames.home / f"{self.source.name}-{_digest(filters, *self.stamps.values())}"

    def maps(self) -> tuple[Stack, Stack | None]:
        """Copy the maps into one file each, joined by frame id; returns depth, and confidence where there is one."""
        if not (self.place / "depth.npy").exists():
            self._copy()
        weight = self.place / "weight.npy"
        return Stack(self.place / "depth.npy"), Stack(weight) if weight.exists() else None

    def sky(self) -> Stack:
        """Tell the sky's pixels, once: where the image shows it and the prior is not sure of a surface.

        Stereo and completion give the sky no confidence, mono no value; a LiDAR's value is sure.
        """
        path = self.place / f"sky{VERSION}.npy"
        if not path.exists():
            depth_m, weight = self.maps()
            drive, positions = self.frames.drive, self.frames.positions
            files = StackWriter(path, depth_m.shape, np.uint8)
            with files as sky, self.frames.progress(f"sky of {drive.name}", len(positions)) as step:
                for position, number in enumerate(positions):
                    sure = depth_m[position] > 0
                    if weight is not None:
                        sure &= weight[position] >= SURE
                    sky.add(sky_mask(drive[number].image()) & ~sure)
                    step()
        return Stack(path)

    def _copy(self) -> None:
        """Write weight.npy, where there is confidence, then depth.npy, which marks both as done."""
        drive, positions = self.frames.drive, self.frames.positions
        shape = (len(positions), *drive[positions[0]].camera.size)
        with ExitStack() as files:
            depth_m = files.enter_context(StackWriter(self.place / "depth.npy", shape, np.float32))
            weight = None
            if self.source.has_confidence:
                weight = files.enter_context(StackWriter(self.place / "weight.npy", shape, np.uint8))
            step = files.enter_context(self.frames.progress(f"maps of {self.source.name}", len(positions)))
            for position in positions:
                frame = drive[position]
                depth = self.frames.filters(self.source.read(frame), frame) if frame.id in self.stamps else None
                depth_m.add(0 if depth is None else depth.depth_m)
                if weight is not None:
                    confidence = None if depth is None else depth.confidence
                    weight.add(0 if confidence is None else np.rint(confidence * 255))
                step()


def _digest(*parts: str) -> str:
    return hashlib.sha256("/".join(parts).encode()).hexdigest()[:10]
