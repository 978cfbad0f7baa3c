"""Training of depth from one image.

    priors train mono runs/bts-m --street samples/ --real DATA --size m --batch 4

It learns from procedural streets (dense, exact), and from real views (real_views.py): KITTI 2015 and drives, by
official truth, LiDAR and confident stereo.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from priors.adapt.objective import loss, predict
from priors.adapt.training_step import Batch
from priors.adapt.views import SKY, SURFACE, UNKNOWN, LabelledView, augment_view, collate
from priors.adapt.windows import random_crop
from priors.codecs import as_rgb
from priors.draw.colours import colour_depth, thicken
from priors.errors import DataError
from priors.learn import pair_file
from priors.learn.crop_pack import CropPack
from priors.learn.moment import STREET
from priors.learn.real_views import SHARES, RealViews
from priors.learn.sample_folder import SampleFolder
from priors.nets import bts
from priors.nets.mobile import Mobile
from priors.types import Image

CROP, ZOOM = (256, 512), (0.65, 1.5)
VALIDATED = 12
"""Rendered samples validated on, about."""
SCORED_M = 80.0
"""Validation looks at depth below this."""


@dataclass(frozen=True)
class MonoConfig:
    """What to learn from and how much of it a step sees."""

    street: Path = Path("street")
    """Folder of samples from `priors train samples`."""
    data: Path | None = None
    """Folder that holds kitti_stereo2015, kitti_raw_train, kitti_odometry or some of them; none: streets only."""
    cache: Path = Path("cache")
    """Where the stereo depth of the odometry pairs is kept."""
    crops: Path | None = None
    """Pack of `priors train pack-crops`, in place of `street` and `data`."""
    imagenet: bool = True
    """Start size m from the ImageNet weights of the package that mobile.IMAGENET names."""
    real_share: float = 0.6
    """Share of real images in a batch."""
    batch: int = 4
    """Crops in a step."""
    size: str = "m"
    """The network's size."""

    def __post_init__(self) -> None:
        if self.batch < 1 or not 0 <= self.real_share <= 1:
            given = f"{self.batch} and {self.real_share}"
            raise DataError(f"training mono: expected batch >= 1 and real_share from 0 to 1, found {given}")


@dataclass
class MonoTask:
    """Teaches Bts depth, sky and its own error; see loop.Task."""

    config: MonoConfig
    net: nn.Module = field(init=False)

    def __post_init__(self) -> None:
        torch.manual_seed(0)
        net = self.net = bts.Bts(self.config.size)
        if self.config.imagenet and isinstance(net.trunk, Mobile):
            net.trunk.take_imagenet()
        if self.config.crops is not None:
            pack = CropPack(self.config.crops)
            self._street: list[Callable[[], LabelledView]] = [moment.view for moment in pack.train[STREET]]
            self._real = {name: [one.view() for one in all_] for name, all_ in pack.train.items() if name != STREET}
            self._held_out = [moment.view() for moments in pack.held_back.values() for moment in moments]
            return
        samples = SampleFolder(self.config.street)
        validation = samples.validation
        self._street = [partial(read_street, path) for path in samples.train]
        self._held_out = [read_street(path) for path in validation[:: max(1, len(validation) // VALIDATED)]]
        real = RealViews(self.config.data, self.config.cache) if self.config.data else None
        self._real = {} if real is None else real.train
        self._held_out += [] if real is None else real.validation

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch of crops."""
        crops = (random_crop(self._draw_view(rng), rng, CROP, ZOOM) for _ in range(self.config.batch))
        return collate([augment_view(crop, rng) for crop in crops])

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss and its parts."""
        return loss(self.net(batch["image"], batch["K"]), batch)

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return AbsRel, RMSE and the sky's IoU by source; "error" is the mean AbsRel over sources."""
        by_source: dict[str, list[list[float]]] = {}
        for view in self._held_out:
            out = predict(net, view.image, view.camera)
            scored = (view.depth_m > 0) & (view.depth_m < SCORED_M)
            truth_m = view.depth_m[scored]
            error_m = out.depth_m[0].numpy()[scored] - truth_m
            sky, is_sky = out.sky_logit[0].numpy() > 0, view.sky == SKY
            sky &= view.sky != UNKNOWN
            iou = np.sum(sky & is_sky) / max(1, np.sum(sky | is_sky)) if is_sky.any() else np.nan
            row = [np.mean(np.abs(error_m) / truth_m), np.sqrt(np.mean(error_m**2)), iou]
            by_source.setdefault(view.source, []).append([float(value) for value in row])
        result: dict[str, float] = {}
        for source, rows in by_source.items():
            for index, name in enumerate(("abs_rel", "rmse", "sky_iou")):
                values = [row[index] for row in rows if np.isfinite(row[index])]
                result[f"{source} {name}"] = float(np.mean(values)) if values else 0.0
        return {"error": float(np.mean([v for k, v in result.items() if k.endswith("abs_rel")])), **result}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw image, truth and result of a view of each source."""
        drawn: dict[str, Image] = {}
        for view in self._held_out:
            if view.source not in drawn:
                out = predict(net, view.image, view.camera)
                depth_m = np.where(out.sky_logit[0].numpy() > 0, np.float32(0), out.depth_m[0].numpy())
                rows = [as_rgb(view.image), thicken(colour_depth(view.depth_m)), colour_depth(depth_m)]
                drawn[view.source] = np.concatenate(rows)
        return drawn

    def _draw_view(self, rng: np.random.Generator) -> LabelledView:
        if self._real and rng.random() < self.config.real_share:
            sources = sorted(self._real)
            weights = np.array([SHARES.get(source, 1.0) for source in sources])
            views = self._real[sources[rng.choice(len(sources), p=weights / weights.sum())]]
            return views[rng.integers(len(views))]
        return self._street[rng.integers(len(self._street))]()


def read_street(path: Path) -> LabelledView:
    """Read a rendered sample as a view; DataError where it is none."""
    pair = pair_file.read(path)
    if pair.sensors is None:
        raise DataError(f"{path}: a training pair without a camera: mono learns from rendered samples only")
    sky = np.where(pair.sky, SKY, SURFACE).astype(np.int8)
    return LabelledView(pair.left, pair.sensors.camera, pair.depth_m, sky, "street")
