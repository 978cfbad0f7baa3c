"""What the completion network learns (`priors train completion`).

The network mends what `methods/completion.py` fills without learning. It sees crops of procedural streets (dense, exact
truth) and of a real drive (points that it is not shown are the truth), through 64 to 8 scan lines or random points.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from priors.adapt.augment import augment
from priors.adapt.batch import Batch
from priors.draw.colours import colour_depth, colour_error, thicken
from priors.errors import DataError
from priors.learn import scans
from priors.learn.accumulated_lidar import Drive
from priors.learn.lidar_scene import Scene, Shown, Streets
from priors.methods.completion import EVERYWHERE_PX, complete
from priors.nets.mffnet import Completed, Mffnet
from priors.types import FloatMap, Image

CROP = (192, 448)
VALIDATED = (1, 1, 4, 1)
"""Every how many-th scan line is shown for validation."""
RELATIVE = 20
"""Weight of the relative error against the absolute one in metres: equal at 20 m."""
HUBER_M = 5.0
"""Errors beyond this count linearly: what neither image nor LiDAR tells must not drown the rest."""


@dataclass(frozen=True)
class CompletionConfig:
    """What to learn from and how much of it a step sees."""

    street: Path = Path("street")
    """Folder of samples from `priors train samples`."""
    real: Path | None = None
    """KITTI raw drive with sweeps, or a folder whose kitti_raw_train/ holds such; never what is tested on."""
    real_share: float = 0.4
    """Share of the real drive's crops in a batch."""
    batch: int = 4
    """Crops in a step."""
    size: str = "m"
    """The network's size."""
    squared: float = 0.5
    """Weight of the squared error (m²) against the absolute one (m)."""
    validation: int = 10
    """Crops of streets validated on."""


@dataclass
class CompletionTask:
    """Teaches MffNet to mend a filled map."""

    config: CompletionConfig
    net: nn.Module = field(init=False)

    def __post_init__(self) -> None:
        torch.manual_seed(0)
        self.net = Mffnet(self.config.size)
        self.streets = Streets(self.config.street)
        self.drive = None if self.config.real is None else Drive(self.config.real)
        self._held: dict[str, list[tuple[Shown, Batch]]] | None = None

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch of crops, their pre-fill and truth."""
        crops: list[Batch] = []
        while len(crops) < self.config.batch:
            shown = scans.show(self._draw(rng), rng)
            if np.any(shown.sparse_m > 0) and np.any(shown.weight > 0):
                crops.append(prepare(shown, augment(shown.scene.image, rng), rng.random() < 0.7))
        return {name: torch.cat([crop[name] for crop in crops]) for name in crops[0]}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss of all three outputs and of the predicted scale."""
        out: Completed = self.net(batch["image"], batch["fill_m"], batch["certain"], batch["sparse_m"])
        truth_m, weight = batch["truth_m"].clamp_min(1e-3), batch["weight"]
        total = weight.sum().clamp_min(1)

        def mean(values: Tensor) -> Tensor:
            return (weight * values).sum() / total

        def deviation(depth_m: Tensor) -> Tensor:
            error_m = (depth_m - truth_m).abs()
            inside = error_m.clamp_max(HUBER_M)
            squared = inside * inside + 2 * HUBER_M * (error_m - inside)
            ratio = (depth_m.log() - truth_m.log()).abs()
            return mean(error_m + self.config.squared * squared + RELATIVE * ratio)

        fit = deviation(out.depth_m)
        parts = sum((deviation(depth_m) for depth_m in out.branches_m), torch.zeros(()))
        ratio = (out.depth_m.detach().log() - truth_m.log()).abs()
        scale = mean(out.log_scale + ratio * torch.exp(-out.log_scale))
        before = mean((batch["fill_m"] - truth_m).abs())
        values = {"fit": fit, "scale": scale, "mae": mean((out.depth_m - truth_m).abs()), "fill_mae": before}
        return fit + 0.3 * parts + 0.1 * scale, {name: value.detach() for name, value in values.items()}

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return errors in metres beside those of the pre-fill; "error" is the mean ratio of the two."""
        values: dict[str, float] = {}
        for name, pairs in self._validation().items():
            sums = np.zeros(8)
            for _, batch in pairs:
                with torch.autocast("cpu", torch.bfloat16):
                    out: Completed = net(batch["image"], batch["fill_m"], batch["certain"], batch["sparse_m"])
                known = batch["weight"] > 0.1
                truth_m, fill_m = batch["truth_m"][known], batch["fill_m"][known]
                error, before = (out.depth_m[known] - truth_m).abs(), (fill_m - truth_m).abs()
                sums += [*_sums(error, truth_m), *_sums(before, truth_m)]
            ours, theirs = sums[1:4] / max(sums[0], 1), np.maximum(sums[5:] / max(sums[4], 1), 1e-9)
            ours[1], theirs[1] = np.sqrt(ours[1]), np.sqrt(theirs[1])
            for key, a, b in zip(("mae", "rmse", "abs_rel"), ours, theirs, strict=True):
                values[f"{name}_{key}"], values[f"{name}_{key}_fill"] = float(a), float(b)
            values[f"{name}_ratio"] = float(np.mean(ours / theirs))
        ratios = [value for key, value in values.items() if key.endswith("_ratio")]
        return {"error": float(np.mean(ratios)), **values}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw image, samples, pre-fill, result, and the error of both."""
        drawn = {}
        for name, pairs in self._validation().items():
            shown, batch = pairs[0]
            with torch.autocast("cpu", torch.bfloat16):
                out: Completed = net(batch["image"], batch["fill_m"], batch["certain"], batch["sparse_m"])
            drawn[name] = draw(shown, batch["fill_m"][0].numpy(), out.depth_m[0].numpy())
        return drawn

    def _draw(self, rng: np.random.Generator) -> Scene:
        """Draw a crop of a street or of the real drive, now and then mirrored, nearer or farther."""
        if self.drive is not None and rng.random() < self.config.real_share:
            scene = self.drive.train[rng.integers(len(self.drive.train))]
            scene = scans.crop(scene, *_window(scene, rng, lowest=True), CROP)
        else:
            scene = Streets.read(self.streets.train[rng.integers(len(self.streets.train))])
            scene = scans.crop(scene, *_window(scene, rng, lowest=False), CROP)
        if rng.random() < 0.5:
            scene = scans.flip(scene)
        return scans.rescale(scene, float(np.exp(rng.normal(0, 0.2)))) if rng.random() < 0.25 else scene

    def _validation(self) -> dict[str, list[tuple[Shown, Batch]]]:
        if self._held is None:
            paths = self.streets.validation
            held = {"street": [Streets.read(path) for path in paths[:: max(1, len(paths) // self.config.validation)]]}
            if self.drive is not None:
                held["real"] = self.drive.validation
            self._held = {}
            for name, scenes in held.items():
                rng = np.random.default_rng(7)
                shown = [scans.show(scene, rng, VALIDATED[i % 4]) for i, scene in enumerate(scenes)]
                self._held[name] = [(one, prepare(one, one.scene.image, True)) for one in shown]
        return self._held


def _sums(error_m: Tensor, truth_m: Tensor) -> list[float]:
    """Return count, sum, sum of squares and sum of relative errors."""
    return [float(len(error_m)), float(error_m.sum()), float((error_m**2).sum()), float((error_m / truth_m).sum())]


def prepare(shown: Shown, image: Image, knows_scanner: bool) -> Batch:
    """Fill the samples without learning and turn everything into tensors with a batch of 1."""
    T_cam_lidar = shown.scene.T_cam_lidar if knows_scanner else None
    fill = complete(shown.sparse_m, image, shown.scene.camera, T_cam_lidar, reach_px=EVERYWHERE_PX)
    maps = {
        "fill_m": fill.depth_m,
        "certain": fill.confidence,
        "sparse_m": shown.sparse_m,
        "truth_m": shown.truth_m,
        "weight": shown.weight,
    }
    batch = {name: torch.from_numpy(np.ascontiguousarray(values))[None] for name, values in maps.items()}
    return {"image": torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255, **batch}


def draw(shown: Shown, fill_m: FloatMap, depth_m: FloatMap) -> Image:
    """Return a picture: image and samples, pre-fill and result, the error of both."""
    truth_m = np.where(shown.weight > 0.1, shown.truth_m, np.float32(0))
    rows = [
        (shown.scene.image, thicken(colour_depth(shown.sparse_m))),
        (colour_depth(fill_m), colour_depth(depth_m)),
        (thicken(colour_error(fill_m, truth_m)), thicken(colour_error(depth_m, truth_m))),
    ]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def _window(scene: Scene, rng: np.random.Generator, lowest: bool) -> tuple[int, int]:
    """Draw where a crop starts (row, column); real LiDAR leaves the upper third of the image empty."""
    height, width = scene.camera.size
    if height < CROP[0] or width < CROP[1]:
        raise DataError(f"completion: scenes of {width}x{height} are smaller than the crop {CROP[1]}x{CROP[0]}")
    top = rng.integers((height - CROP[0]) // 2 if lowest else 0, height - CROP[0] + 1)
    return int(top), int(rng.integers(width - CROP[1] + 1))
