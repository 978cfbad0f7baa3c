"""Training of the completion network (`priors train completion runs/mffnet-s`).

The network corrects what `methods/completion.py` fills without learning. It sees crops of procedural streets, whose
truth is dense and exact, of KITTI 2015, and of real drives, where points that it is not shown are the truth. It is
shown one to eleven sweeps, 64 to 8 scan lines, or random points.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from priors.adapt.augment import augment
from priors.adapt.objective import masked_mean
from priors.adapt.training_step import Batch, to_device
from priors.draw.colours import colour_depth, colour_error, thicken
from priors.errors import DataError
from priors.learn import lidar_scene
from priors.learn.accumulated_lidar import INPUTS
from priors.learn.crop_pack import CropPack
from priors.learn.lidar_dropout import CompletionExample, Density, drop_points
from priors.learn.lidar_scene import LidarScene
from priors.learn.moment import STREET, Moment
from priors.learn.real_scenes import RealScenes
from priors.learn.sample_folder import SampleFolder
from priors.methods._completion_classical import EVERYWHERE_PX, complete
from priors.nets.mffnet import Completed, Mffnet
from priors.types import FloatMap, Image, Matrix

CROP = (192, 448)
DENSITIES = (Density(), Density(every=4), Density(every=8), Density(points=500), *map(Density.accumulated, INPUTS))
"""What is shown for validation, in turn; a scene that has one sweep is shown by the first four."""
RELATIVE = 20
"""Weight of the relative error against the absolute one in metres: equal at 20 m."""
HUBER_M = 5.0
"""Errors beyond this count linearly: what neither image nor LiDAR tells must not drown the rest."""
LEAST_WEIGHT = 0.1
"""Of the truth that validation counts."""
KNOWS_SCANNER = 0.7
"""Share of the crops whose pre-fill knows where the scanner stood."""


@dataclass(frozen=True)
class CompletionConfig:
    """What to learn from and how much of it a step sees."""

    street: Path = Path("street")
    """Folder of samples from `priors train samples`."""
    real: Path | None = None
    """KITTI raw drive with sweeps, or a folder with such in kitti_raw_train/ and with pairs in kitti_stereo2015/;
    never what is tested on."""
    crops: Path | None = None
    """Pack of `priors train pack-crops`, in place of `street` and `real`."""
    real_share: float = 0.55
    """Share of real crops in a batch."""
    batch: int = 4
    """Crops in a step."""
    size: str = "m"
    """The network's size."""
    squared: float = 0.5
    """Weight of the squared error (m²) against the absolute one (m)."""
    validation: int = 18
    """Street samples validated on."""

    def __post_init__(self) -> None:
        if not 0 <= self.real_share <= 1:
            raise DataError(f"training completion: real_share is {self.real_share}, expected 0 to 1")
        if self.batch < 1 or self.validation < 1 or not self.squared >= 0:
            given = f"{self.batch}, {self.validation} and {self.squared}"
            raise DataError(f"training completion: expected batch, validation >= 1 and squared >= 0, found {given}")


@dataclass
class CompletionTask:
    """Teaches MffNet to correct a filled map; see loop.Task."""

    config: CompletionConfig
    net: nn.Module = field(init=False)

    def __post_init__(self) -> None:
        torch.manual_seed(0)
        self.net = Mffnet(self.config.size)
        self.real: RealScenes | None = None
        self._street: list[Callable[[], LidarScene]]
        self._streets_held_back: list[Callable[[], LidarScene]]
        if self.config.crops is not None:
            pack = CropPack(self.config.crops)
            self._street, self._streets_held_back = _packed(pack.train), _packed(pack.held_back)
            self.real = RealScenes.packed(pack)
        else:
            samples = SampleFolder(self.config.street)
            every = max(1, len(samples.validation) // self.config.validation)
            self._street = [partial(lidar_scene.read_street, path) for path in samples.train]
            self._streets_held_back = [partial(lidar_scene.read_street, p) for p in samples.validation[::every]]
            if self.config.real is not None:
                self.real = RealScenes.read(self.config.real)
        self._held_back: dict[str, list[tuple[CompletionExample, Batch]]] | None = None

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch of crops, their pre-fill and truth."""
        crops: list[Batch] = []
        while len(crops) < self.config.batch:
            example = drop_points(self._draw_scene(rng), rng)
            if np.any(example.sparse_m > 0) and np.any(example.weight > 0):
                image = augment(example.scene.image, rng)
                T_cam_lidar = example.T_cam_lidar if rng.random() < KNOWS_SCANNER else None
                crops.append(to_batch(example, image, T_cam_lidar))
        return {name: torch.cat([crop[name] for crop in crops]) for name in crops[0]}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss of all three outputs and of the predicted scale."""
        out = _run(self.net, batch)
        truth_m, weight = batch["truth_m"].clamp_min(1e-3), batch["weight"]

        def deviation(depth_m: Tensor) -> Tensor:
            error_m = (depth_m - truth_m).abs()
            inside = error_m.clamp_max(HUBER_M)
            squared = inside * inside + 2 * HUBER_M * (error_m - inside)
            ratio = (depth_m.log() - truth_m.log()).abs()
            return masked_mean(error_m + self.config.squared * squared + RELATIVE * ratio, weight)

        fit = deviation(out.depth_m)
        parts = sum((deviation(depth_m) for depth_m in out.branches_m), torch.zeros(()))
        ratio = (out.depth_m.detach().log() - truth_m.log()).abs()
        scale = masked_mean(out.log_scale + ratio * torch.exp(-out.log_scale), weight)
        before = masked_mean((batch["fill_m"] - truth_m).abs(), weight)
        mae = masked_mean((out.depth_m - truth_m).abs(), weight)
        values = {"fit": fit, "scale": scale, "mae": mae, "fill_mae": before}
        return fit + 0.3 * parts + 0.1 * scale, {name: value.detach() for name, value in values.items()}

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return errors in metres beside the pre-fill's, by source and density; "error" is the mean of their ratios."""
        values: dict[str, float] = {}
        for name, examples in self._validation().items():
            sums = np.zeros(8)
            for _, batch in examples:
                out = _look(net, batch)
                counts = batch["weight"] > LEAST_WEIGHT
                truth_m, fill_m = batch["truth_m"][counts], batch["fill_m"][counts]
                error, before = (out.depth_m[counts] - truth_m).abs(), (fill_m - truth_m).abs()
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
        for name, examples in self._validation().items():
            example, batch = examples[0]
            out = _look(net, batch)
            drawn[name] = make_picture(example, batch["fill_m"][0].numpy(), out.depth_m[0].numpy())
        return drawn

    def held_back(self) -> dict[str, list[CompletionExample]]:
        """Return what is validated on, by source and density."""
        return {name: [example for example, _ in pairs] for name, pairs in self._validation().items()}

    def _draw_scene(self, rng: np.random.Generator) -> LidarScene:
        """Draw a crop of a street or of a real scene, now and then mirrored, nearer or farther."""
        if self.real is not None and self.real.train and rng.random() < self.config.real_share:
            scenes = list(self.real.train.values())[rng.choice(len(self.real.train), p=self.real.shares())]
            scene = scenes[rng.integers(len(scenes))]
        else:
            scene = self._street[rng.integers(len(self._street))]()
        scene = lidar_scene.crop(scene, *_draw_corner(scene, rng), CROP)
        if rng.random() < 0.5:
            scene = lidar_scene.flip(scene)
        return lidar_scene.rescale(scene, float(np.exp(rng.normal(0, 0.2)))) if rng.random() < 0.25 else scene

    def _validation(self) -> dict[str, list[tuple[CompletionExample, Batch]]]:
        if self._held_back is None:
            held_back = [read() for read in self._streets_held_back]
            if self.real is not None:
                held_back += [scene for scenes in self.real.validation.values() for scene in scenes]
            self._held_back = _examples(held_back)
        return self._held_back


def _examples(scenes: list[LidarScene]) -> dict[str, list[tuple[CompletionExample, Batch]]]:
    """Show each scene at one density; by source and density."""
    rng, shown = np.random.default_rng(7), dict[str, int]()
    examples: dict[str, list[tuple[CompletionExample, Batch]]] = {}
    for scene in scenes:
        shown_as = (1, *(scene.accumulated_m if scene.real else INPUTS))
        densities = [density for density in DENSITIES if density.sweeps in shown_as]
        turn = shown[scene.source] = shown.get(scene.source, -1) + 1
        density = densities[turn % len(densities)]
        example = drop_points(scene, rng, density)
        batch = to_batch(example, scene.image, example.T_cam_lidar)
        examples.setdefault(f"{scene.source}_{density}", []).append((example, batch))
    return examples


def _packed(part: dict[str, list[Moment]]) -> list[Callable[[], LidarScene]]:
    return [moment.scene for moment in part.get(STREET, [])]


def _look(net: nn.Module, batch: Batch) -> Completed:
    """Run a network where it is; the maps come back to the CPU."""
    device = next(net.parameters()).device
    with torch.autocast(device.type, torch.bfloat16):
        out = _run(net, to_device(batch, device))
    return Completed(out.depth_m.float().cpu(), out.log_scale.float().cpu(), ())


def _run(net: nn.Module, batch: Batch) -> Completed:
    completed: Completed = net(batch["image"], batch["fill_m"], batch["certain"], batch["sparse_m"])
    return completed


def _sums(error_m: Tensor, truth_m: Tensor) -> list[float]:
    """Return count, sum, sum of squares and sum of relative errors."""
    return [float(len(error_m)), float(error_m.sum()), float((error_m**2).sum()), float((error_m / truth_m).sum())]


def to_batch(example: CompletionExample, image: Image, T_cam_lidar: Matrix | None) -> Batch:
    """Fill the samples without learning and turn everything into tensors with a batch of 1.

    Args:
        example: what is shown and the truth.
        image: (h, w, 3), the scene's or an augmented one.
        T_cam_lidar: where the scanner stood, for the pre-fill; None: it does not know.
    """
    fill = complete(example.sparse_m, image, example.scene.camera, T_cam_lidar, reach_px=EVERYWHERE_PX)
    if fill.confidence is None:
        raise ValueError("complete() gives a confidence with every map")
    maps = {
        "fill_m": fill.depth_m,
        "certain": fill.confidence,
        "sparse_m": example.sparse_m,
        "truth_m": example.truth_m,
        "weight": example.weight,
    }
    batch = {name: torch.from_numpy(np.ascontiguousarray(values))[None] for name, values in maps.items()}
    return {"image": torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255, **batch}


def make_picture(example: CompletionExample, fill_m: FloatMap, depth_m: FloatMap) -> Image:
    """Return a picture: image and samples, pre-fill and result, the error of both."""
    truth_m = np.where(example.weight > LEAST_WEIGHT, example.truth_m, np.float32(0))
    rows = [
        (example.scene.image, thicken(colour_depth(example.sparse_m))),
        (colour_depth(fill_m), colour_depth(depth_m)),
        (thicken(colour_error(fill_m, truth_m)), thicken(colour_error(depth_m, truth_m))),
    ]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def _draw_corner(scene: LidarScene, rng: np.random.Generator) -> tuple[int, int]:
    """Draw where a crop starts (row, column); real LiDAR leaves the upper third of the image empty."""
    height, width = scene.camera.size
    if height < CROP[0] or width < CROP[1]:
        raise DataError(f"completion: scenes of {width}x{height} are smaller than the crop {CROP[1]}x{CROP[0]}")
    top = rng.integers((height - CROP[0]) // 2 if scene.real else 0, height - CROP[0] + 1)
    return int(top), int(rng.integers(width - CROP[1] + 1))
