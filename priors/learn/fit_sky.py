"""Training of the sky mask's network (sky_net.py); writes weights/sky.npz.

    python -m priors.learn.fit_sky runs/sky --data ../shared/data --streets street21 street22 --steps 900

It learns from CamVid's training split, outlined KITTI frames and rendered streets; with --teachers, runs that learned
from those, also from KITTI frames that these, LiDAR and matching label (sky_evidence.py). A run that was stopped goes
on with the same command.
"""

import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
import tyro
from torch import Tensor, nn

from eval.files import write_bytes
from priors import sky
from priors.adapt.training_step import Batch
from priors.errors import DataError
from priors.kernels.sky_net import Layers, forward
from priors.learn import checkpoint
from priors.learn.config import TrainConfig
from priors.learn.loop import TrainProgress, train
from priors.learn.sky_augment import draw_view
from priors.learn.sky_evidence import Labeller, read_evidence
from priors.learn.sky_labels import SKY, UNKNOWN, SkySample, of_place, read_camvid, read_kitti, read_street
from priors.learn.sky_net import SkyNet, fold
from priors.nets.weights import load
from priors.sky import Floats
from priors.types import FloatMap, Image, Mask

SHAPES = ((144, 256), (176, 208), (112, 320))
"""Heights and widths of views."""
SHARES = {"street": 0.7, "06": 0.5, "01": 0.4, "image_02": 0.4, "kitti2015": 1.5, "drive0009": 0.3}
"""How often a place is drawn from, where not once: it has few images."""


@dataclass(frozen=True)
class SkyFit:
    """Train the sky mask's network."""

    out: Annotated[Path, tyro.conf.Positional]
    """The run's folder."""
    data: Path
    """Folder that holds camvid, kitti_odometry, kitti_raw_train and kitti_stereo2015."""
    streets: tuple[Path, ...] = ()
    """Folders written by `priors street`."""
    teachers: tuple[Path, ...] = ()
    """Folders of runs that label KITTI frames; none: these are not learned from."""
    start: Path | None = None
    """Folder of a run whose best network this one starts from; none: from ImageNet's weights."""
    weights: Path | None = None
    """Where the finished network's weights go; none: they stay in the run's folder."""
    how: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def main(arguments: list[str] | None = None) -> None:
    """Train, print each place's IoU, and write the weights; takes the command line's arguments."""
    fit = tyro.cli(SkyFit, args=arguments, description=__doc__)
    samples = [*read_labelled(fit.data, fit.streets)]
    if fit.teachers:
        samples += read_evidence(fit.data, average([read_run(run) for run in fit.teachers]))
    task = SkyTask(samples, list(read_camvid(fit.data / "camvid", "val")), start=fit.start)
    print(train(task, fit.out, fit.how, on_step=tell))
    if fit.weights is not None:
        write(fit.weights, read_run(fit.out))
        print(f"wrote {fit.weights}")


def tell(progress: TrainProgress) -> None:
    """Print how far a training is."""
    terms = ", ".join(f"{name} {value:.3f}" for name, value in progress.values.items())
    print(f"{progress.done:4.0%} step {progress.step}: {terms}", flush=True)


def read_labelled(data: Path, streets: Iterable[Path]) -> list[SkySample]:
    """Read what has labels: CamVid's training split, outlined KITTI frames, streets."""
    samples = [*read_camvid(data / "camvid", "train"), *read_kitti(data)]
    return samples + [sample for street in streets for sample in read_street(street)]


def average(runs: Sequence[Layers]) -> Labeller:
    """Return a labeller whose logits are the mean of networks'."""

    def see(image: Image) -> FloatMap:
        colour = sky.shrink_to_see(image)
        logit = np.mean([forward(colour, layers) for layers in runs], axis=0)
        return np.asarray(cv2.resize(logit, (image.shape[1], image.shape[0])), np.float32)

    return see


def read_run(run: Path) -> Layers:
    """Return the layers of a run's best network."""
    net = SkyNet()
    net.load_state_dict(load(run / checkpoint.BEST).tensors)
    return as_layers(fold(net.eval()))


def as_layers(arrays: dict[str, Floats]) -> Layers:
    """Pair weights and biases, rounded as the file of weights rounds them."""
    rounded = {name: np.ascontiguousarray(array.astype(np.float16), np.float32) for name, array in arrays.items()}
    return sky.pair_layers(rounded)


def write(path: Path, layers: Layers) -> None:
    """Write layers as the mask reads them, float16."""
    arrays: dict[str, Any] = {}
    for name, (weights, bias) in layers.items():
        arrays[f"{name}.w"], arrays[f"{name}.b"] = weights.astype(np.float16), bias.astype(np.float16)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(path, buffer.getvalue())


@dataclass
class SkyTask:
    """Teaches SkyNet which pixels are sky; see training_run.Task."""

    samples: Sequence[SkySample]
    judged: Sequence[SkySample]
    """Images to validate on."""
    batch_size: int = 8
    start: Path | None = None
    """Folder of a run to start from; none: from ImageNet's weights."""
    net: nn.Module = field(init=False)

    def __post_init__(self) -> None:
        torch.manual_seed(0)
        self.net = SkyNet()
        if self.start is None:
            self.net.take_imagenet()
        else:
            self.net.load_state_dict(load(self.start / checkpoint.BEST).tensors)
        self._places = sorted({sample.place for sample in self.samples})
        if not self._places:
            raise DataError("sky: no labelled image to learn from: name a folder that holds some by --data")
        shares = np.array([SHARES.get(place, 1.0) for place in self._places])
        self._shares = shares / shares.sum()
        self._of = {place: of_place(self.samples, place) for place in self._places}

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch of views of one shape."""
        size = SHAPES[rng.integers(len(SHAPES))]
        views = []
        for _ in range(self.batch_size):
            there = self._of[self._places[rng.choice(len(self._places), p=self._shares)]]
            views.append(draw_view(there[rng.integers(len(there))], size, rng))
        images = np.stack([sky.brighten(image.astype(np.float32) / np.float32(255)) for image, _ in views])
        return {
            "image": torch.from_numpy(images).permute(0, 3, 1, 2),
            "label": torch.from_numpy(np.stack([label for _, label in views])),
        }

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return cross-entropy and the soft intersection over union (Rahman and Wang, 2016), over known pixels."""
        logit, (share, known) = self.net(batch["image"]).float(), batch["label"].unbind(1)
        weight = (known > 0.7).float()
        entropy = (F.binary_cross_entropy_with_logits(logit, share, reduction="none") * weight).sum()
        entropy = entropy / weight.sum().clamp(min=1)
        found = logit.sigmoid()
        both = (weight * found * share).sum()
        overlap = both / ((weight * (found + share)).sum() - both).clamp(min=1)
        return entropy + 0.3 * (1 - overlap), {"entropy": entropy.detach(), "iou": overlap.detach()}

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return the IoU of each place judged, "error" is what its mean lacks."""
        layers = as_layers(fold(net))
        found = {
            place: overlap(of_place(self.judged, place), lambda image: sky.find_sky(image, layers))
            for place in sorted({sample.place for sample in self.judged})
        }
        return {"error": 1 - float(np.mean(list(found.values()))), **found}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw nothing: what counts is seen in whole frames, by the mask itself."""
        return {}


def overlap(samples: Sequence[SkySample], find: Callable[[Image], Mask]) -> float:
    """Return the intersection over union of what is found and what is sky, over all known pixels of samples."""
    both = either = 0
    for sample in samples:
        found, known, true = find(sample.image), sample.label != UNKNOWN, sample.label == SKY
        both += int(np.count_nonzero(found & true))
        either += int(np.count_nonzero((found | true) & known))
    return both / max(1, either)


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
