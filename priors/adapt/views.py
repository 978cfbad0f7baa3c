"""Labelled views, what a depth network for single images learns from: an image, its camera, and depth where known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from priors.adapt.augment import augment
from priors.adapt.training_step import Batch
from priors.codecs import as_rgb
from priors.types import Camera, FloatMap, Image

LARGEST_M = 150.0
"""Depth beyond this teaches nothing."""
SKY, SURFACE, UNKNOWN = 1, 0, -1
"""Labels of a pixel."""


@dataclass(frozen=True, slots=True)
class LabelledView:
    """One image and what is known of it."""

    image: Image
    """(h, w, 3) RGB or (h, w) grey."""
    camera: Camera
    depth_m: FloatMap
    """(h, w), 0 = not known; dense or sparse."""
    sky: npt.NDArray[np.int8]
    """(h, w) SKY, SURFACE or UNKNOWN."""
    source: str
    """Where it comes from, for the log."""


def label_sky(image: Image, depth_m: FloatMap) -> npt.NDArray[np.int8]:
    """Label a real image: a surface where there is depth, sky where the sky mask says so and there is none."""
    from priors.sky import sky_mask

    return np.where(depth_m > 0, SURFACE, np.where(sky_mask(image), SKY, UNKNOWN)).astype(np.int8)


def augment_view(view: LabelledView, rng: np.random.Generator) -> LabelledView:
    """Change exposure, colour, sharpness and noise of a view's image as cameras do."""
    return replace(view, image=augment(view.image, rng))


def collate(views: Sequence[LabelledView]) -> Batch:
    """Stack views of one size: image (b, 3, h, w) in [0, 1], K (b, 3, 3), depth_m and sky (b, h, w)."""
    return {
        "image": to_tensor([view.image for view in views]),
        "K": torch.from_numpy(np.stack([v.camera.K for v in views])).float(),
        "depth_m": torch.from_numpy(np.stack([v.depth_m for v in views])),
        "sky": torch.from_numpy(np.stack([v.sky for v in views])).float(),
    }


def to_tensor(images: Sequence[Image]) -> Tensor:
    """Stack images of one size: (b, 3, h, w) in [0, 1], channels-last; grey is repeated."""
    stacked = torch.from_numpy(np.stack([as_rgb(image) for image in images])).permute(0, 3, 1, 2).float() / 255
    return stacked.contiguous(memory_format=torch.channels_last)
