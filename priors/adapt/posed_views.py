"""Posed views of one scene: a target and its neighbours, what photometric supervision compares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from priors.adapt.training_frames import pick_evenly
from priors.adapt.training_step import Batch
from priors.adapt.views import LabelledView, augment_view, collate
from priors.adapt.windows import Window, crop, draw_window
from priors.codecs import as_rgb
from priors.errors import DataError
from priors.motion import Trajectory
from priors.types import Camera, Drive, FloatMap, Image, Matrix

NEAREST_M, WANTED_M, FARTHEST_M = 0.3, 1.0, 3.0
"""How far a neighbour's camera may have moved: below, pixels hardly shift; beyond, near things have left the image."""
REACH = 30
"""Frames to look through for it, before and after."""
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class SourceView:
    """A neighbour's image, whole."""

    image: Image
    camera: Camera
    T_source_target: Matrix
    """(4, 4), metres."""


@dataclass(frozen=True, slots=True)
class PosedView:
    """A target view and its neighbours."""

    view: LabelledView
    """The target; its depth and sky are what the starting network says."""
    log_scale: FloatMap
    """(h, w) the starting network's."""
    sources: tuple[SourceView, SourceView]
    """One before and one after; the same twice where only one is there."""


def pair_up(drive: Drive, indices: Sequence[int], most: int) -> dict[int, tuple[int, int]]:
    """Return the neighbours, before and after, of at most `most` frames, all among the given ones.

    A frame and its neighbours lie on one side of a break of the path.

    Raises DataError where frames have no poses, or lie too close or too far apart.
    """
    frames = {index: drive[index] for index in indices}
    poses = {index: frame.T_world_cam for index, frame in frames.items() if frame.T_world_cam is not None}
    path = Trajectory.of_frames(list(frames.values()))
    parts = _parts(path, {index: frames[index].id for index in poses})
    instead = "choose --mono.adapt lidar or stereo"
    if not poses:
        where = "KITTI's oxts, poses/<sequence>.txt, a folder's poses.txt"
        raise DataError(f"{drive.name}: no training frame has a pose: --mono.adapt video needs {where}; or {instead}")
    pairs = {
        index: near
        for part in parts
        for index in part
        if (near := neighbours({other: poses[other] for other in part}, index)) is not None
    }
    if not pairs:
        raise DataError(
            f"{drive.name}: no two training frames lie {NEAREST_M} to {FARTHEST_M} m apart, which --mono.adapt video "
            f"needs (poses are in metres): {instead}"
        )
    return {index: pairs[index] for index in pick_evenly(list(pairs), most)}


def _parts(path: Trajectory, ids: Mapping[int, str]) -> list[list[int]]:
    """Cut positions in the drive, with their frames' ids, where the path breaks."""
    parts: list[list[int]] = []
    for index in ids:
        if not parts or path.broken(ids[parts[-1][-1]], ids[index]):
            parts.append([])
        parts[-1].append(index)
    return parts


def neighbours(poses: Mapping[int, Matrix], target: int) -> tuple[int, int] | None:
    """Return the frames before and after that lie nearest to WANTED_M away, one twice where only one is there.

    Args:
        poses: T_world_cam by position in the drive.
        target: one of them.
    """
    nearest = []
    for way in (-1, 1):
        near: dict[int, float] = {}
        for index in range(target + way, target + way * (REACH + 1), way):
            if index in poses:
                moved_m = float(np.linalg.norm(poses[index][:3, 3] - poses[target][:3, 3]))
                if NEAREST_M <= moved_m <= FARTHEST_M:
                    near[index] = abs(np.log(moved_m / WANTED_M))
        if near:
            nearest.append(min(near, key=near.__getitem__))
    return (nearest[0], nearest[-1]) if nearest else None


def posed_batch(
    clips: Sequence[PosedView], rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float], shrink: int
) -> Batch:
    """Cut a random window of every clip's view.

    Args:
        clips: of one camera.
        rng: draws windows and paint.
        size: of the crops, (height, width).
        zoom: how many times larger their content may become.
        shrink: how many times smaller the neighbours are than the crops' content.

    Returns:
        What `collate` does, of repainted crops; and target (b, 3, h, w), the crops as they were taken; log_scale
        (b, h, w); sources (b, 2, 3, height, width); and where a target's pixel (u, v) of depth d lies in a source
        whose image spans [-1, 1]: d * turn (u, v, 1) + shift, or still (u, v, 1) if the camera had not moved.
    """
    windows = [draw_window(clip.view.camera.size, rng, size, zoom) for clip in clips]
    views = [crop(clip.view, window) for clip, window in zip(clips, windows, strict=True)]
    height, width = (max(1, round(n * windows[0].factor / shrink)) for n in clips[0].sources[0].camera.size)
    images = [[resize(source.image, (height, width)) for source in clip.sources] for clip in clips]
    places = [
        [place(source, window, view.camera) for source in clip.sources]
        for clip, window, view in zip(clips, windows, views, strict=True)
    ]
    turn, shift, still = (np.array([[p[n] for p in two] for two in places], np.float32) for n in range(3))
    return {
        **collate([augment_view(view, rng) for view in views]),
        "target": collate(views)["image"],
        "log_scale": torch.from_numpy(np.stack([w.map(c.log_scale) for c, w in zip(clips, windows, strict=True)])),
        "sources": torch.from_numpy(np.array(images)).permute(0, 1, 4, 2, 3).float() / 255,
        "turn": torch.from_numpy(turn),
        "shift": torch.from_numpy(shift),
        "still": torch.from_numpy(still),
    }


def resize(image: Image, size: tuple[int, int]) -> Image:
    """Resize an image to (height, width); grey is repeated."""
    way = cv2.INTER_AREA if size[0] < image.shape[0] else cv2.INTER_LINEAR
    return as_rgb(np.asarray(cv2.resize(image, size[::-1], interpolation=way), np.uint8))


def place(source: SourceView, window: Window, camera: Camera) -> tuple[Matrix, Matrix, Matrix]:
    """Return turn (3, 3), shift (3,) and still (3, 3), see `crops`.

    Args:
        source: the neighbour.
        window: the target's.
        camera: the window's.
    """
    height, width = source.camera.size
    span = np.array([[2 / width, 0, 1 / width - 1], [0, 2 / height, 1 / height - 1], [0, 0, 1]]) @ source.camera.K
    back = (MIRROR if window.mirrored else np.eye(3)) @ np.linalg.inv(camera.K)
    T = source.T_source_target
    return span @ T[:3, :3] @ back, span @ T[:3, 3], span @ back
