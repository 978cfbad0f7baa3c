"""Train depth from one image: priors train mono RUN --street samples/ --real DATA --size m --batch 4.

From procedural streets (dense, exact), a KITTI drive's LiDAR (sparse) and grey KITTI odometry pairs whose depth our
classical matcher is sure of (computed once, cached in RUN).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors import build, drives
from priors.colours import as_rgb, colour_depth, thicken
from priors.drives import DriveOptions
from priors.filters import Filters
from priors.known import trusted
from priors.learn import sample as samples
from priors.learn.loop import Batch
from priors.learn.scans import Streets
from priors.learn.views import LARGEST_M, SKY, SURFACE, UNKNOWN, View, collate, cut, label_sky, repaint
from priors.learn.weighing import mean
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.nets import bts
from priors.nets.mobile import Mobile
from priors.types import Image

CROP, ZOOM = (256, 512), (0.65, 1.5)
HELD_OUT = {"sfnd": 4, "06": 6, "01": 6}
"""Last frames of each real drive: for validation."""
OFFSETS_PX = {"06": (0.0, 0.0, 1.4), "01": (0.0, 0.0, 2.4)}
"""What the rectification of KITTI odometry's pairs is off, against depth from ego-motion (docs/methods/stereo.md)."""


@dataclass(frozen=True)
class MonoConfig:
    """What to learn from and how much of it a step sees."""

    street: Path = Path("street")
    """Folder of samples from `priors train samples`."""
    data: Path | None = None
    """Folder that holds kitti_raw_train, kitti_odometry or both; none: streets only."""
    cache: Path = Path("cache")
    """Where the stereo depth of the odometry pairs is kept."""
    real_share: float = 0.5
    """Share of real images in a batch."""
    batch: int = 4
    """Crops in a step."""
    size: str = "m"
    """The network's size."""
    imagenet: bool = True
    """Start size m from the ImageNet weights of the package that mobile.IMAGENET names."""


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
        self._streets = Streets(self.config.street)
        validation = self._streets.validation
        self._held = [read_street(path) for path in validation[:: max(1, len(validation) // 12)]]
        self._real: dict[str, list[View]] = {}
        for view in read_real(self.config.data, self.config.cache) if self.config.data else ():
            self._real.setdefault(view.source, []).append(view)
        for source, count in HELD_OUT.items():
            self._held += self._real.get(source, [])[-count:]
            self._real[source] = self._real.get(source, [])[:-count]
        self._real = {source: views for source, views in self._real.items() if views}

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch of crops."""
        return collate([repaint(cut(self._draw(rng), rng, CROP, ZOOM), rng) for _ in range(self.config.batch)])

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss and its parts."""
        return loss(self.net(batch["image"], batch["K"]), batch)

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return AbsRel, RMSE and the sky's IoU by source; "error" is the mean AbsRel over sources."""
        found: dict[str, list[list[float]]] = {}
        for view in self._held:
            out = predict(net, view)
            known = (view.depth_m > 0) & (view.depth_m < 80)
            error_m = out.depth_m[0].numpy()[known] - view.depth_m[known]
            sky, is_sky = out.sky_logit[0].numpy() > 0, view.sky == SKY
            sky &= view.sky != UNKNOWN
            iou = np.sum(sky & is_sky) / max(1, np.sum(sky | is_sky)) if is_sky.any() else np.nan
            row = [np.mean(np.abs(error_m) / view.depth_m[known]), np.sqrt(np.mean(error_m**2)), iou]
            found.setdefault(view.source, []).append([float(value) for value in row])
        result: dict[str, float] = {}
        for source, rows in found.items():
            for index, name in enumerate(("abs_rel", "rmse", "sky_iou")):
                values = [row[index] for row in rows if np.isfinite(row[index])]
                result[f"{source} {name}"] = float(np.mean(values)) if values else 0.0
        return {"error": float(np.mean([v for k, v in result.items() if k.endswith("abs_rel")])), **result}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw image, truth and result of a view of each source."""
        drawn: dict[str, Image] = {}
        for view in self._held:
            if view.source not in drawn:
                out = predict(net, view)
                depth_m = np.where(out.sky_logit[0].numpy() > 0, np.float32(0), out.depth_m[0].numpy())
                rows = [as_rgb(view.image), thicken(colour_depth(view.depth_m)), colour_depth(depth_m)]
                drawn[view.source] = np.concatenate(rows)
        return drawn

    def _draw(self, rng: np.random.Generator) -> View:
        if self._real and rng.random() < self.config.real_share:
            views = self._real[sorted(self._real)[rng.integers(len(self._real))]]
            return views[rng.integers(len(views))]
        return read_street(self._streets.train[rng.integers(len(self._streets.train))])


def read_street(path: Path) -> View:
    """Read a rendered sample as a view."""
    found = samples.read(path)
    return View(found.left, found.camera, found.depth_m, np.where(found.sky, SKY, SURFACE).astype(np.int8), "street")


def read_real(data: Path, cache: Path) -> Iterator[View]:
    """Read the training drives: LiDAR of the slow colour drive, confident stereo of the grey odometry runs."""
    lidar, folder = Lidar(sweeps=1), data / "kitti_raw_train" / "2011_09_26" / "2011_09_26_drive_sfnd_sync"
    slow = drives.open_drive(folder) if folder.is_dir() else ()
    for index in range(len(slow)):
        frame = slow[index]
        image, depth_m = frame.image(), lidar(frame).depth_m
        yield View(image, frame.camera, depth_m, label_sky(image, depth_m), "sfnd")
    for sequence, offset_px in OFFSETS_PX.items() if (data / "kitti_odometry").is_dir() else ():
        drive = drives.open_drive(data / "kitti_odometry", options=DriveOptions(drive=sequence))
        prior, method = build.prepare(drive, "stereo", Stereo(offset_px=offset_px), Filters(), cache)
        build.build(drive, prior, method, Filters(), build.plan(drive, prior, method.reads, build.Selection()))
        for index, id_ in enumerate(drive.ids):
            frame = drive[index]
            image, depth = frame.image(), prior.read(id_)
            depth_m = trusted(depth, image)
            sky = label_sky(image, depth_m)
            sky[(trusted(depth) > 0) & (depth_m == 0)] = UNKNOWN  # matched sky, or a bright wall taken for sky
            yield View(image, frame.camera, depth_m, sky, sequence)


def predict(net: nn.Module, view: View, bf16: bool = True) -> bts.MonoOut:
    """Run a network on a whole view; the maps are (1, h, w) on the CPU."""
    batch = collate([view])
    device = next(net.parameters()).device
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=bf16):
        out: bts.MonoOut = net(batch["image"].to(device), batch["K"].to(device))
    return bts.MonoOut(*(map_.float().cpu() for map_ in (out.depth_m, out.sky_logit, out.log_scale, out.coarse_m)))


def loss(out: bts.MonoOut, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
    """Return BTS's scale-invariant loss, plus gradients, sky, predicted error and the coarse planes; and the parts."""
    truth_m, sky = batch["depth_m"], batch["sky"]
    known = (truth_m > 0) & (truth_m < LARGEST_M)
    error = torch.where(known, out.depth_m.log() - truth_m.clamp_min(1e-3).log(), 0.0)
    coarse_m = nearest_of_cells(torch.where(known, truth_m, 0.0))
    coarse_error = torch.where(coarse_m > 0, out.coarse_m.log() - coarse_m.clamp_min(1e-3).log(), 0.0)
    fit, coarse = silog(error, known), silog(coarse_error, coarse_m > 0)
    edges = sum((steps(error, known, stride) for stride in (1, 2, 4, 8)), error.new_zeros(()))
    sky_loss = mean(F.binary_cross_entropy_with_logits(out.sky_logit, sky.clamp_min(0), reduction="none"), sky >= 0)
    size = error.detach().abs()
    scale = mean(out.log_scale + size * torch.exp(-out.log_scale), known)
    total = fit + 0.3 * coarse + edges + 0.5 * sky_loss + 0.1 * scale
    parts = {"silog": fit, "edges": edges, "sky": sky_loss, "scale": scale, "log_error": mean(size, known)}
    return total, {name: value.detach() for name, value in parts.items()}


def silog(error: Tensor, known: Tensor, balance: float = 0.85) -> Tensor:
    """Return BTS's 10 sqrt(mean(g^2) - balance mean(g)^2) of log errors g (b, h, w) where known, mean over images."""
    count = known.flatten(1).sum(1)
    weight = known.flatten(1) / count.clamp_min(1)[:, None]
    error = error.flatten(1)
    variance = (weight * error**2).sum(1) - balance * (weight * error).sum(1) ** 2
    there = count > 0
    return 10 * (torch.sqrt(variance.clamp_min(1e-6)) * there).sum() / there.sum().clamp_min(1)


def steps(error: Tensor, known: Tensor, stride: int) -> Tensor:
    """Return the mean absolute difference of neighbouring log errors, `stride` pixels apart: wrong edges and slopes."""
    error, known = error[:, ::stride, ::stride], known[:, ::stride, ::stride]
    across = mean((error[:, :, 1:] - error[:, :, :-1]).abs(), known[:, :, 1:] & known[:, :, :-1])
    down = mean((error[:, 1:] - error[:, :-1]).abs(), known[:, 1:] & known[:, :-1])
    return across + down


def nearest_of_cells(depth_m: Tensor) -> Tensor:
    """Return the nearest known depth of every 4x4 pixels, 0 where none is: (b, ceil(h / 4), ceil(w / 4))."""
    inverse = torch.where(depth_m > 0, 1 / depth_m.clamp_min(1e-3), 0.0)
    most = F.max_pool2d(inverse[:, None], 4, ceil_mode=True)[:, 0]
    return torch.where(most > 0, 1 / most.clamp_min(1e-6), 0.0)
