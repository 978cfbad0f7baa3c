"""What a drive's training frames teach the single-image network: chosen, put into the key, read when needed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import nn

from priors import geometry
from priors.adapt.depth_supervision import DepthSupervision
from priors.adapt.finetune import AdaptConfig, Supervision
from priors.adapt.posed_views import pair_up
from priors.adapt.selection import MOST_VIEWS, pick_evenly, read_each
from priors.adapt.video_supervision import LEARNING_RATE, VideoSupervision, read_posed_view
from priors.adapt.views import LabelledView, label_sky
from priors.errors import DataError
from priors.methods._reference import Known
from priors.records import original, record
from priors.types import Drive, Frame, Matrix


@dataclass(frozen=True)
class Lesson:
    """Supervision to come."""

    what: str
    """What supervises, in a word or two."""
    frames: list[str]
    """Ids of the frames that the network learns on."""
    decides: dict[str, Any]
    """What else decides the result, for the key."""
    read: Callable[[nn.Module, bool], Supervision]
    """Reads it, given the starting network in eval mode and whether that runs in bf16."""
    lr: float = AdaptConfig.lr
    """The learning rate that suits it."""


def by_depth(drive: Drive, indices: Sequence[int], known: Known) -> Lesson:
    """Teach by depth that the frames know, a few of them."""
    picked = pick_evenly(indices, MOST_VIEWS)

    def read(start: nn.Module, bf16: bool) -> Supervision:
        return DepthSupervision(read_each(drive, picked, lambda index: as_view(drive[index], known), known.source))

    return Lesson(f"{known.source} depth", [drive.ids[index] for index in picked], original(Known, record(known)), read)


def by_video(drive: Drive, indices: Sequence[int]) -> Lesson:
    """Teach by each other, a few frames and their posed neighbours; DataError where poses are missing."""
    pairs = pair_up(drive, indices, MOST_VIEWS)

    def read(start: nn.Module, bf16: bool) -> Supervision:
        views = read_each(
            drive, list(pairs), lambda i: read_posed_view(drive, i, pairs[i], start, bf16), "posed images"
        )
        return VideoSupervision(views)

    seen = [[[drive.ids[other], _moved(drive[index], drive[other])] for other in pairs[index]] for index in pairs]
    frames, decides = [drive.ids[index] for index in pairs], {"source": "video", "seen": seen}
    return Lesson("posed neighbours", frames, decides, read, LEARNING_RATE)


def as_view(frame: Frame, known: Known) -> LabelledView:
    """Return a frame as what the network learns from; DataError where nothing is known."""
    image, depth_m = frame.image(), known(frame)
    if depth_m.shape != image.shape[:2]:
        raise DataError(f"frame {frame.id}: image {image.shape[:2]} and depth {depth_m.shape} differ in size")
    if not np.any(depth_m > 0):
        raise DataError(f"frame {frame.id}: no {known.source} depth in its image")
    return LabelledView(image, frame.camera, np.asarray(depth_m, np.float32), label_sky(image, depth_m), known.source)


def _moved(frame: Frame, other: Frame) -> list[float]:
    T_a, T_b = frame.T_world_cam, other.T_world_cam
    assert T_a is not None and T_b is not None
    T_b_a: Matrix = geometry.invert(T_b) @ T_a
    return [round(float(value), 6) for value in T_b_a[:3].ravel()]
