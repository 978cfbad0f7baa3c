"""Training of the sky mask: fits its two rules and writes weights/sky.npz.

    python -m priors.learn.fit_sky --data ../shared/data --streets street21 street22

Both rules are dense networks with one hidden layer; the second sees the first one's answer. So that rule 2
learns how far rule 1 can be trusted in a new place, it is fitted on answers of rules that had not seen the place.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import tyro

from priors import sky
from priors.codecs import as_rgb
from priors.errors import DataError
from priors.kernels.sky import shrink
from priors.learn.sky_augment import augment
from priors.learn.sky_labels import SKY, UNKNOWN, SkySample, read_camvid, read_kitti, read_street
from priors.types import FloatMap, Image

Floats = npt.NDArray[np.float32]
COPIES = {"0001": 6, "0006": 4, "0016": 2, "06": 90, "01": 50, "image_02": 70, "street": 12}
"""How many augmented copies of each image: places with few images get more."""
BLOCKS_PER_IMAGE = 250
DECAY = 1e-4


@dataclass(frozen=True)
class SkyFit:
    """Fit the sky mask on CamVid's training split, a few KITTI training frames and rendered streets."""

    data: Path
    """Folder that holds camvid, kitti_odometry and kitti_raw_train."""
    streets: tuple[Path, ...] = ()
    """Folders written by `priors street`."""
    out: Path = sky.WEIGHTS
    """Where the weights go."""
    seed: int = 0
    """Decides the augmented copies, the blocks drawn and the start of the fit."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise DataError(f"--seed is {self.seed}, expected 0 or more")


def main(arguments: list[str] | None = None) -> None:
    """Fit, write, and print how each place fares when it is held out; takes the command line's arguments."""
    fit = tyro.cli(SkyFit, args=arguments, description=__doc__)
    samples = read_samples(fit)
    places = sorted({sample.place for sample in samples})
    firsts, labels = first_blocks(samples, places, fit.seed)
    print({place: len(label) for place, label in zip(places, labels, strict=True)})
    values = held_out_blocks(samples, places, (firsts, labels), fit.seed)
    for held, place in enumerate(places):
        rule = fit_layers(*without(values, labels, held), fit.seed)
        both, first = iou(sky.apply_layers(rule, values[held].T), labels[held]), iou(values[held][:, 0], labels[held])
        print(f"{place} held out: IoU {both:.3f}, rule 1 {first:.3f}")
    rules = fit_layers(firsts, labels, fit.seed), fit_layers(values, labels, fit.seed)
    arrays = {
        f"rule{number}_{name}{depth}": array
        for number, rule in enumerate(rules, 1)
        for depth, layer in enumerate(rule)
        for name, array in zip("wb", layer, strict=True)
    }
    np.savez(fit.out, **arrays)  # type: ignore[arg-type]
    print(f"wrote {fit.out}")


def read_samples(fit: SkyFit) -> list[SkySample]:
    """Read what is fitted on."""
    samples = [*read_camvid(fit.data / "camvid", "train"), *read_kitti(fit.data)]
    return samples + [sample for street in fit.streets for sample in read_street(street)]


def first_blocks(samples: Sequence[SkySample], places: Sequence[str], seed: int) -> tuple[list[Floats], list[Floats]]:
    """Draw blocks of every place: what rule 1 sees of them, and their share of sky."""
    blocks = [sample_blocks(of_place(samples, place), seed) for place in places]
    firsts = [np.concatenate([first for first, *_ in group]) for group in blocks]
    return firsts, [np.concatenate([label for *_, label in group]) for group in blocks]


def held_out_blocks(
    samples: Sequence[SkySample], places: Sequence[str], first: tuple[list[Floats], list[Floats]], seed: int
) -> list[Floats]:
    """Return what rule 2 sees of the same blocks, given rules 1 that had not seen the place."""
    values = []
    for held, place in enumerate(places):
        rule = fit_layers(*without(*first, held), seed)
        values.append(second_blocks(of_place(samples, place), rule, seed)[0])
    return values


def without(values: list[Floats], labels: list[Floats], held: int) -> tuple[list[Floats], list[Floats]]:
    """Leave one place out."""
    return values[:held] + values[held + 1 :], labels[:held] + labels[held + 1 :]


def iou(logit: FloatMap, label: FloatMap) -> float:
    """Return intersection over union of what is found and what is sky."""
    both = int(np.count_nonzero((logit > 0) & (label > 0.5)))
    return both / max(1, int(np.count_nonzero((logit > 0) | (label > 0.5))))


def of_place(samples: Iterable[SkySample], place: str) -> list[SkySample]:
    """Return a place's samples."""
    return [sample for sample in samples if sample.place == place]


def sample_blocks(samples: Sequence[SkySample], seed: int) -> list[tuple[Floats, Floats]]:
    """Draw blocks of every image and its augmented copies: what `describe` says of them and their share of sky."""
    rng = np.random.default_rng(seed)
    drawn = []
    for image, label in with_copies(samples, rng):
        first, _ = sky.describe(*blocks_of(image))
        chosen, share = draw_blocks(label, first.shape[1], first.shape[2], rng)
        drawn.append((first.reshape(len(first), -1)[:, chosen].T, share))
    return drawn


def second_blocks(samples: Sequence[SkySample], rule: sky.Layers, seed: int) -> tuple[Floats, Floats]:
    """Draw the same blocks: what `compare` says of them, given rule 1."""
    rng = np.random.default_rng(seed)
    values, shares = [], []
    for image, label in with_copies(samples, rng):
        first, colour = sky.describe(*blocks_of(image))
        second = sky.compare(first, colour, sky.apply_layers(rule, first))
        chosen, share = draw_blocks(label, first.shape[1], first.shape[2], rng)
        values.append(second.reshape(len(second), -1)[:, chosen].T)
        shares.append(share)
    return np.concatenate(values), np.concatenate(shares)


def blocks_of(image: Image) -> tuple[Floats, FloatMap]:
    """Average an image to blocks, as `sky_mask` does."""
    image = as_rgb(image)
    return shrink(np.ascontiguousarray(image), sky.block_side(*image.shape[:2]))


def draw_blocks(
    label: FloatMap, rows: int, columns: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], Floats]:
    """Draw blocks whose label is known: their flat indices and their share of sky."""
    size = (columns, rows)
    share = cv2.resize((label == SKY).astype(np.float32), size, interpolation=cv2.INTER_AREA).ravel()
    unknown = cv2.resize((label == UNKNOWN).astype(np.float32), size, interpolation=cv2.INTER_AREA).ravel()
    labelled = np.flatnonzero(unknown < 0.3)
    chosen = rng.choice(labelled, BLOCKS_PER_IMAGE) if labelled.size else labelled
    return chosen, share[chosen].astype(np.float32)


def with_copies(samples: Sequence[SkySample], rng: np.random.Generator) -> Iterable[tuple[Image, FloatMap]]:
    """Yield every image as it is, then its augmented copies."""
    for sample in samples:
        yield sample.image, sample.label
        for _ in range(COPIES[sample.place]):
            yield augment(sample.image, sample.label, rng)


def fit_layers(
    values: Sequence[Floats], labels: Sequence[Floats], seed: int, hidden: int = 24, epochs: int = 6
) -> sky.Layers:
    """Fit one hidden layer to shares of sky by cross-entropy (Adam, cosine decay, weight decay); inputs are whitened.

    Returns:
        (weights, bias) per layer, for inputs as they are.
    """
    x, y = np.concatenate(values), np.concatenate(labels)
    mean, deviation = x.mean(axis=0), x.std(axis=0) + 1e-6
    x = (x - mean) / deviation
    rng = np.random.default_rng(seed)
    sizes = [x.shape[1], hidden, 1]
    layers = [
        [rng.normal(0, np.sqrt(2 / a), (a, b)).astype(np.float32), np.zeros(b, np.float32)]
        for a, b in itertools.pairwise(sizes)
    ]
    moments = [[[np.zeros_like(p), np.zeros_like(p)] for p in layer] for layer in layers]
    batch, step = 2048, 0
    steps = epochs * (len(y) // batch)
    for _ in range(epochs):
        order = rng.permutation(len(y))
        for start in range(0, len(y) - batch + 1, batch):
            chosen = order[start : start + batch]
            step += 1
            rate = 3e-3 * 0.5 * (1 + np.cos(np.pi * step / steps))
            for layer, grads, kept in zip(layers, gradients(layers, x[chosen], y[chosen]), moments, strict=True):
                for parameter, grad, moment in zip(layer, grads, kept, strict=True):
                    moment[0] = 0.9 * moment[0] + 0.1 * grad
                    moment[1] = 0.99 * moment[1] + 0.01 * grad * grad
                    scale = np.sqrt(moment[1] / (1 - 0.99**step)) + 1e-8
                    parameter -= (rate * (moment[0] / (1 - 0.9**step)) / scale).astype(np.float32)
    weights, bias = layers[0]
    layers[0] = [weights / deviation[:, None], bias - (mean / deviation) @ weights]
    return tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in layers)


def gradients(layers: Sequence[Sequence[Floats]], x: Floats, y: Floats) -> list[tuple[Floats, Floats]]:
    """Return the loss's gradient for each layer's weights and bias."""
    inputs = [x]
    for weights, bias in layers[:-1]:
        inputs.append(np.maximum(inputs[-1] @ weights + bias, 0))
    logit = (inputs[-1] @ layers[-1][0] + layers[-1][1])[:, 0]
    error = ((sky.sigmoid(logit) - y) / len(y))[:, None]
    out = []
    for (weights, _), values in zip(layers[::-1], inputs[::-1], strict=True):
        out.append((values.T @ error + DECAY * weights, error.sum(axis=0)))
        error = (error @ weights.T) * (values > 0)
    return out[::-1]


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
