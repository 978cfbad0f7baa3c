"""Supervision of the single-image network by a drive's training frames: planned, put into the key, read when needed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import nn

from priors import geometry
from priors.adapt.depth_supervision import DepthSupervision
from priors.adapt.finetune import AdaptConfig, Supervision
from priors.adapt.posed_views import pair_up
from priors.adapt.training_frames import MOST_VIEWS, pick_evenly, read_each
from priors.adapt.video_supervision import LEARNING_RATE, VideoSupervision, read_posed_view
from priors.adapt.views import LabelledView, label_sky
from priors.errors import DataError
from priors.methods._reference import ReferenceDepth
from priors.records import original, record
from priors.types import Drive, Frame, Matrix


@dataclass(frozen=True)
class PlannedSupervision:
    """What the network will learn on a drive; nothing is read yet."""

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


def by_depth(drive: Drive, indices: Sequence[int], reference: ReferenceDepth) -> PlannedSupervision:
    """Plan to learn on the reference depth of a few of the frames."""
    picked = pick_evenly(indices, MOST_VIEWS)

    def read(start: nn.Module, bf16: bool) -> Supervision:
        return DepthSupervision(
            read_each(drive, picked, lambda index: as_view(drive[index], reference), reference.source)
        )

    ids = [drive.ids[index] for index in picked]
    return PlannedSupervision(f"{reference.source} depth", ids, original(ReferenceDepth, record(reference)), read)


def by_video(drive: Drive, indices: Sequence[int]) -> PlannedSupervision:
    """Plan to learn on a few frames and their posed neighbours, which show the same scene.

    Raises DataError where poses are missing.
    """
    pairs = pair_up(drive, indices, MOST_VIEWS)

    def read(start: nn.Module, bf16: bool) -> Supervision:
        views = read_each(
            drive, list(pairs), lambda i: read_posed_view(drive, i, pairs[i], start, bf16=bf16), "posed images"
        )
        return VideoSupervision(views)

    near = [[[drive.ids[other], _motion(drive[index], drive[other])] for other in pairs[index]] for index in pairs]
    frames, decides = [drive.ids[index] for index in pairs], {"source": "video", "seen": near}
    return PlannedSupervision("posed neighbours", frames, decides, read, LEARNING_RATE)


def as_view(frame: Frame, reference: ReferenceDepth) -> LabelledView:
    """Return a frame as what the network learns from; DataError where it has no reference depth."""
    image, depth_m = frame.image(), reference(frame)
    if depth_m.shape != image.shape[:2]:
        raise DataError(f"frame {frame.id}: image {image.shape[:2]} and depth {depth_m.shape} differ in size")
    if not np.any(depth_m > 0):
        raise DataError(f"frame {frame.id}: no {reference.source} depth in its image")
    return LabelledView(
        image, frame.camera, np.asarray(depth_m, np.float32), label_sky(image, depth_m), reference.source
    )


def _motion(frame: Frame, other: Frame) -> list[float]:
    """Return the motion from a frame to another, 12 numbers of a (3, 4) pose; DataError where one has no pose."""
    T_b_a: Matrix = geometry.invert(other.pose()) @ frame.pose()
    return [round(float(value), 6) for value in T_b_a[:3].ravel()]
