"""Photometric supervision of metric depth: a scene is seen from posed places.

The poses are in metres, so the depth becomes metric. Where nothing tells depth (bare road, glare), the relief stays
what the starting network makes of it; so do its sky and its expected error, of which a video says nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors import geometry
from priors.adapt.depth_hints import find_hints
from priors.adapt.objective import edge_loss, masked_mean, predict
from priors.adapt.photometric import photometric, roughness
from priors.adapt.posed_views import PosedView, SourceView, posed_batch
from priors.adapt.training_step import Batch
from priors.adapt.views import SKY, SURFACE, UNKNOWN, LabelledView
from priors.adapt.windows import ZOOM, crop_size
from priors.errors import DataError
from priors.nets.bts import MonoOut
from priors.types import Drive, Frame

SMALL = 192
"""Crops less high than this are compared at full size, others at half, which is as good and four times as fast."""
LEVELS = 3
"""Sizes that are compared, each half the one before. Hints come from the smallest."""
LEARNING_RATE = 1e-4
"""A third of what known depth allows: what a few images show of each other is a noisier guide."""
ERROR, HINT, RELIEF, ROUGH = 10.0, 4.0, 0.1, 0.02
"""Weights of the photometric error, of the hints, of the starting network's relief and of smoothness."""


@dataclass(frozen=True)
class VideoSupervision:
    """Supervises by views and their posed neighbours; see finetune.Supervision."""

    views: Sequence[PosedView]
    measures: str = "photometric error"

    def batch(self, rng: np.random.Generator, count: int) -> Batch:
        """Make a batch of crops."""
        size = crop_size([posed.view for posed in self.views])
        zoom = float(np.exp(rng.uniform(*np.log(ZOOM))))  # one for all, so that the neighbours are of one size
        picked = [self.views[int(rng.integers(len(self.views)))] for _ in range(count)]
        return posed_batch(picked, rng, size, (zoom, zoom), finest(size[0]))

    def loss(self, out: MonoOut, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return photometric error, smoothness, and what keeps the rest as the starting network has it."""
        surface, labelled = batch["sky"] == SURFACE, batch["sky"] != UNKNOWN
        inverse, first = 1 / out.depth_m, finest(out.depth_m.shape[1])
        strides = [first * 2**level for level in range(LEVELS)]
        hints = find_hints(inverse, surface, batch, strides[-1], first)
        near = surface & ~F.interpolate(hints.elsewhere[:, None].float(), surface.shape[1:])[:, 0].bool()
        wrong = torch.stack([photometric(inverse, near, batch, stride, first) for stride in strides]).mean()
        change = out.depth_m.log() - batch["depth_m"].log()
        relief = sum((edge_loss(change, surface, stride) for stride in (1, 2, 4, 8)), change.new_zeros(()))
        rough = roughness(inverse, batch["target"], surface)
        is_sky = (batch["sky"] == SKY).float()
        sky = masked_mean(F.binary_cross_entropy_with_logits(out.sky_logit, is_sky, reduction="none"), labelled)
        scale = masked_mean((out.log_scale - batch["log_scale"]).abs(), surface)
        scene = ERROR * wrong + HINT * hints.error() + RELIEF * relief + ROUGH * rough
        return scene + 0.5 * sky + 0.1 * scale, wrong.detach()


def finest(height: int) -> int:
    """Return how many times smaller than crops of a height their pictures are compared."""
    return 1 if height < SMALL else 2


def read_posed_view(drive: Drive, index: int, near: tuple[int, int], start: nn.Module, *, bf16: bool) -> PosedView:
    """Read a frame, its neighbours and what the starting network says about it.

    Args:
        drive: the drive.
        index: of the frame.
        near: its neighbours'; all have poses.
        start: the network, in eval mode.
        bf16: whether to run it in bf16.
    """
    from priors.sky import sky_mask

    frame = drive[index]
    image = frame.image()
    out = predict(start, image, frame.camera, bf16=bf16)
    ours, theirs = out.sky_logit[0].numpy() > 0, sky_mask(image)
    sky = np.where(ours == theirs, np.where(ours, SKY, SURFACE), UNKNOWN).astype(np.int8)
    view = LabelledView(image, frame.camera, out.depth_m[0].numpy(), sky, "video")
    if not np.any(sky == SURFACE):
        raise DataError(f"frame {frame.id}: nothing but sky")
    before, after = (_source(frame, drive[other]) for other in near)
    return PosedView(view, out.log_scale[0].numpy(), (before, after))


def _source(frame: Frame, other: Frame) -> SourceView:
    return SourceView(other.image(), other.camera, geometry.invert(other.pose()) @ frame.pose())
