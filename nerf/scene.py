"""A scene: the drive's frames and a prior's maps in files that are never held whole, in the drive's own metric frame.

Prepared once a drive and once a prior, then shared by every run on them:

    <folder>/<drive>-<digest>/images.npy         uint8 (frames, height, width, 3)
                             /frames.json        ids, camera, poses
                             /<prior>/depth.npy  float32 (frames, height, width), metres, 0 = no value
                             /<prior>/weight.npy uint8 (frames, height, width), confidence x 255; where there is one
"""

import hashlib
import json
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from nerf.split import split
from nerf.stack import Stack, StackWriter
from nerf.types import Rays
from priors.cache import Prior
from priors.errors import DataError
from priors.filters import Filters
from priors.geometry import rays as pixel_rays
from priors.types import Camera, Depth, Drive, Matrix

LARGEST_STEP_M = 30.0
"""Camera motion between neighbouring frames beyond which poses are taken to have jumped, metres."""
Progress = Callable[[str, int], AbstractContextManager[Callable[..., None]]]
"""Opens a progress bar of a label and a number of frames; yields what is called after each."""


@dataclass(frozen=True)
class Scene:
    """Frames with poses and, where a prior is given, its depth; arrays or, on disk, stacks."""

    name: str
    ids: list[str]
    camera: Camera
    T_world_cam: npt.NDArray[np.float64]
    """(frames, 4, 4)"""
    images: Stack | npt.NDArray[np.uint8]
    """(frames, height, width, 3)"""
    depth_m: Stack | npt.NDArray[np.float32] | None
    """(frames, height, width) the prior, 0 = no value; frames the prior lacks are all 0."""
    weight: Stack | npt.NDArray[np.uint8] | None
    """(frames, height, width) the prior's confidence x 255."""
    train: list[int]
    """Positions of the training frames."""
    test: list[int]
    """Positions of the held-out frames."""

    def draw(self, count: int, seed: int, step: int) -> Rays:
        """Draw `count` training rays; the same seed and step draw the same ones."""
        height, width = self.camera.size
        random = np.random.Generator(np.random.Philox(key=[seed, step]))
        flat = random.integers(0, len(self.train) * height * width, count)
        which, pixel = np.divmod(flat, height * width)
        frame = np.asarray(self.train)[which]
        return self.rays(frame, *np.divmod(pixel, width))

    def rays(self, frame: npt.NDArray[Any], row: npt.NDArray[Any], column: npt.NDArray[Any]) -> Rays:
        """Return the rays through pixels, (r,) each, with colour and prior."""
        K = self.camera.K
        x, y = (column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1]
        pose = self.T_world_cam[frame]
        directions = np.einsum("rij,rj->ri", pose[:, :3, :3], np.stack([x, y, np.ones_like(x)], axis=1))
        depth_m = None if self.depth_m is None else _tensor(self.depth_m[frame, row, column])
        weight = None if self.weight is None else _tensor(self.weight[frame, row, column] / np.float32(255))
        rgb = _tensor(self.images[frame, row, column] / np.float32(255))
        return Rays(_tensor(pose[:, :3, 3]), _tensor(directions), rgb, depth_m, weight, 1 / self.camera.fx)

    def points_m(self, most: int = 2_000_000) -> npt.NDArray[np.float32]:
        """Back-project the training frames' prior: up to about `most` world points (n, 3), evenly thinned."""
        if self.depth_m is None:
            return np.zeros((0, 3), np.float32)
        directions = pixel_rays(self.camera)
        stride = max(1, round(len(self.train) * directions[..., 0].size / most))
        found = []
        for position in self.train:
            thinned = slice(position % stride, None, stride)
            depth_m = self.depth_m[position].reshape(-1)[thinned]
            known = (depth_m > 0) & np.isfinite(depth_m)
            camera = directions.reshape(-1, 3)[thinned][known] * depth_m[known, None]
            pose = self.T_world_cam[position]
            found.append((camera @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32))
        return np.concatenate(found)


def view_rays(camera: Camera, T_world_cam: Matrix) -> Rays:
    """Return the rays of a whole view, row by row; no colour, no prior."""
    directions = pixel_rays(camera).reshape(-1, 3) @ T_world_cam[:3, :3].T
    origins = np.broadcast_to(T_world_cam[:3, 3], directions.shape)
    return Rays(_tensor(origins), _tensor(directions), pixel=1 / camera.fx)


def silent(label: str, count: int) -> AbstractContextManager[Callable[..., None]]:
    """Show no progress."""
    return nullcontext(lambda: None)


def open_scene(
    drive: Drive,
    prior: Prior | None,
    views: str,
    positions: list[int],
    folder: Path,
    filters: Filters | None = None,
    progress: Progress = silent,
) -> Scene:
    """Prepare a drive (the frames at `positions`) and a prior for training, or open what was prepared before.

    `filters` thin the prior's maps once more, without another cache; `progress` shows what is prepared, if anything.

    Raises:
        DataError: frames lack poses, poses jump, or the prior was made for another drive or camera, or has no frame
            or no value in common with the training frames.
    """
    ids = [drive.ids[position] for position in positions]
    train, test = split(len(ids), views)
    home = folder / f"{drive.name}-{_digest(drive.fingerprint(), *ids)}"
    maps = {} if prior is None else _maps(prior, drive, ids)
    record = _prepare_images(drive, positions, home, progress)
    camera = Camera(np.array(record["K"]), tuple(record["size"]))
    depth_m, weight = None, None
    if prior is not None:
        depth_m, weight = _prepare_prior(prior, drive, positions, maps, filters or Filters(), home, progress)
        if not any((depth_m[position] > 0).any() for position in train):
            found = f"no value in any of the {len(train)} training frames"
            raise DataError(f"{prior.folder}: {found}: build or filter it anew")
    poses, images = np.array(record["T_world_cam"]), Stack(home / "images.npy")
    return Scene(drive.name, ids, camera, poses, images, depth_m, weight, train, test)


def _prepare_images(drive: Drive, positions: list[int], home: Path, progress: Progress) -> dict[str, Any]:
    """Write images and poses unless they are there; the record is written last and marks them as done."""
    path = home / "frames.json"
    if not path.exists():
        poses = _poses(drive, positions)
        first = drive[positions[0]]
        shape = (len(positions), *first.camera.size, 3)
        files = StackWriter(home / "images.npy", shape, np.uint8)
        with files as images, progress(f"images of {drive.name}", len(positions)) as step:
            for position in positions:
                image = drive[position].image()
                images.add(image if image.ndim == 3 else image[..., None])
                step()
        ids = [drive.ids[position] for position in positions]
        record = {"ids": ids, "K": first.camera.K.tolist(), "size": first.camera.size, "T_world_cam": poses.tolist()}
        _write_json(path, record)
    return json.loads(path.read_text())


def _poses(drive: Drive, positions: list[int]) -> npt.NDArray[np.float64]:
    """Collect the poses; DataError where one is missing, not finite, or far from its neighbour."""
    poses = []
    for position in positions:
        frame = drive[position]
        if frame.T_world_cam is None or not np.isfinite(frame.T_world_cam).all():
            raise DataError(
                f"{drive.name}: frame {frame.id} has no pose: a field needs poses (`priors check` tells more)"
            )
        poses.append(frame.T_world_cam)
    stacked = np.array(poses)
    steps_m = np.linalg.norm(np.diff(stacked[:, :3, 3], axis=0), axis=1)
    allowed_m = np.maximum(LARGEST_STEP_M, 5 * np.median(steps_m)) if len(steps_m) else 0
    jumps = np.flatnonzero(steps_m > allowed_m)
    if len(jumps):
        at = drive.ids[positions[int(jumps[0]) + 1]]
        raise DataError(f"{drive.name}: the pose jumps {steps_m[jumps[0]]:.0f} m before frame {at}: cut with --frames")
    return stacked


def _maps(prior: Prior, drive: Drive, ids: list[str]) -> dict[str, str]:
    """Return what tells apart the maps of the frames that have one, by frame id.

    Raises:
        DataError: no frame has a map, or the prior is of another drive.
    """
    made_for = prior.manifest.get("fingerprint")
    if made_for is not None and made_for != drive.fingerprint():
        raise DataError(f"{prior.folder}: made for {prior.drive.get('path')}, not for this {drive.name}: build it anew")
    maps = {}
    for id_ in ids:
        with suppress(FileNotFoundError):
            found = prior.depth_path(id_).stat()
            maps[id_] = f"{id_}:{found.st_size}:{found.st_mtime_ns}"
    if not maps:
        raise DataError(f"{prior.folder}: none of the {len(ids)} frames has a map: build the prior for them")
    return maps


def _prepare_prior(
    prior: Prior,
    drive: Drive,
    positions: list[int],
    maps: dict[str, str],
    filters: Filters,
    home: Path,
    progress: Progress,
) -> tuple[Stack, Stack | None]:
    """Copy a prior's filtered maps into one file each, joined by frame id."""
    place = home / f"{prior.name}-{_digest(json.dumps(filters.record()), *maps.values())}"
    if not (place / "depth.npy").exists():
        _copy_maps(prior, drive, positions, set(maps), filters, place, progress)
    weight = place / "weight.npy"
    return Stack(place / "depth.npy"), Stack(weight) if weight.exists() else None


def _copy_maps(
    prior: Prior,
    drive: Drive,
    positions: list[int],
    common: set[str],
    filters: Filters,
    place: Path,
    progress: Progress,
) -> None:
    """Write weight.npy, where there is confidence, then depth.npy, which marks both as done."""
    size = drive[positions[0]].camera.size
    shape = (len(positions), *size)
    with ExitStack() as files:
        depth_m = files.enter_context(StackWriter(place / "depth.npy", shape, np.float32))
        weight = None
        if prior.confidence_path("").parent.is_dir():
            weight = files.enter_context(StackWriter(place / "weight.npy", shape, np.uint8))
        step = files.enter_context(progress(f"maps of {prior.name}", len(positions)))
        for position in positions:
            made = _map(prior, drive, position, filters) if drive.ids[position] in common else None
            depth_m.add(0 if made is None else made.depth_m)
            if weight is not None:
                confidence = None if made is None else made.confidence
                weight.add(0 if confidence is None else np.rint(confidence * 255))
            step()


def _map(prior: Prior, drive: Drive, position: int, filters: Filters) -> Depth:
    """Read and filter a frame's map."""
    frame = drive[position]
    made, size = prior.read(frame.id), frame.camera.size
    if made.depth_m.shape != size:
        raise DataError(f"{prior.depth_path(frame.id)}: {made.depth_m.shape}, the images are {size}: build it again")
    return filters(made, frame)


def _write_json(path: Path, record: dict[str, Any]) -> None:
    from priors.codecs import write_bytes

    write_bytes(path, json.dumps(record).encode())


def _digest(*parts: str) -> str:
    return hashlib.sha256("/".join(parts).encode()).hexdigest()[:10]


def _tensor(array: npt.NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
