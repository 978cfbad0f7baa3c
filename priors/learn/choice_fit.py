"""Fit of a depth choice (methods/_completion_choice.py), on scenes that training may use.

    priors train choice priors/weights/mffnet-s.safetensors --street samples/ --real DATA

The network completes whole images: KITTI 2015 and drives but for what is held back, and street samples. Each scene is
shown twice: with all of its own sweep, and as training would show it, one to eleven sweeps with lines and windows left
out. Of each, some pixels are drawn that the rule would be asked for and whose truth is known. The rule learns from the
loss that the network learned from. Before it is fitted to all scenes, a quarter of them is left out in turn: that says
what it is worth on scenes that it has not seen. What is written goes into the header.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from priors.errors import DataError
from priors.learn import lidar_scene
from priors.learn.completion import HUBER_M, RELATIVE
from priors.learn.lidar_dropout import CompletionExample, Density, drop_points
from priors.learn.lidar_scene import LidarScene
from priors.learn.moment import STREET
from priors.learn.real_scenes import RealScenes
from priors.learn.rule_net import NEIGHBOURS, PARTS, RuleNet, draw_batch, leave_out
from priors.learn.sample_folder import SampleFolder
from priors.methods import _completion_choice as choice
from priors.methods._completion_choice import DepthChoice, Pixels
from priors.methods._completion_classical import EVERYWHERE_PX, clean_map, complete, list_samples, near_samples
from priors.methods._completion_network import look
from priors.methods.completion import Completion
from priors.nets import runtime, weights
from priors.nets.runtime import Ready
from priors.types import FloatMap

PER_MAP = 4000
"""Pixels drawn of each map."""
STREETS = 24
"""Samples of streets that are looked at, spread evenly: their truth is dense."""
LEAST_WEIGHT = 0.1
"""Of the truth that counts."""
HIDDEN = (24, 24)
"""Values of the hidden layers."""
STEPS, BATCH, RATE, DECAY = 3000, 2048, 5e-3, 1e-3
SQUARED = 0.1
"""Weight of the squared error (m²) against the absolute one (m); the network learned with five times as much."""


@dataclass(frozen=True, slots=True)
class KnownPixels:
    """Pixels of any number of maps, n in all, that the rule is asked for and whose truth is known."""

    clues: FloatMap
    """(CLUES, n)."""
    offered: FloatMap
    """(OFFERED, n) logarithms of depths, metres."""
    truth: FloatMap
    """(n,) logarithm of the depth."""
    weight: FloatMap
    """(n,) those of a map have in all the share that they are of its known pixels."""
    part: npt.NDArray[np.int64]
    """(n,) which part the scene is of."""
    source: npt.NDArray[np.str_]
    """(n,) where the scene comes from."""

    def take(self, which: npt.NDArray[np.bool_]) -> "KnownPixels":
        """Return those where `which` (n,) is True."""
        rest = self.truth[which], self.weight[which], self.part[which], self.source[which]
        return KnownPixels(self.clues[:, which], self.offered[:, which], *rest)


def fit_file(file: Path, street: Path, real: Path | None) -> list[str]:
    """Fit the choice of a file of weights, rewriting its header; returns lines that say what it is worth.

    DataError where the weights are another network's, or there is nothing to fit to.
    """
    about = weights.read_about(file)
    ready = runtime.open_net(about["net"], about["size"], runtime.choose_floating("auto", file, about["net"]), file)
    pixels = collect(ready, scenes(street, real))
    lines = list(cross_validate(pixels))
    weights.rewrite_about(file, **{choice.ENTRY: fit(pixels).record()})
    return lines


def scenes(street: Path, real: Path | None) -> Iterator[tuple[int, LidarScene]]:
    """Return the scenes to fit to, each with its number in its source: of neighbours the numbers follow each other."""
    if real is not None:
        for found in RealScenes.read(real).train.values():
            yield from enumerate(found)
    train = SampleFolder(street).train
    for number, path in enumerate(train[:: max(1, len(train) // STREETS)]):
        yield number * NEIGHBOURS, lidar_scene.read_street(path)


def collect(ready: Ready, found: Iterable[tuple[int, LidarScene]], seed: int = 0) -> KnownPixels:
    """Complete scenes and draw pixels of each; DataError where there are none.

    Args:
        ready: the network.
        found: scenes with their numbers.
        seed: decides what is shown of a scene, and which pixels are drawn.
    """
    rng, parts = np.random.default_rng(seed), []
    for number, scene in found:
        for example in (drop_points(scene, rng, Density()), drop_points(scene, rng)):
            if np.any(example.sparse_m > 0) and np.any(example.weight > LEAST_WEIGHT):
                *drawn, weight = _draw(ready, example, rng)
                source = STREET if not scene.real else scene.source
                part = np.full(weight.size, number // NEIGHBOURS % PARTS)
                parts.append((*drawn, weight, part, np.full(weight.size, source)))
    if not parts:
        raise DataError("no scenes with truth to fit to: name samples by --street, and real data by --real")
    return KnownPixels(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _draw(ready: Ready, example: CompletionExample, rng: np.random.Generator) -> tuple[FloatMap, ...]:
    """Return a map's clues (CLUES, n), what is offered (OFFERED, n), truth and weights (n,)."""
    scene, size = example.scene, example.sparse_m.shape
    samples = list_samples(example.sparse_m)
    fill = complete(example.sparse_m, scene.image, scene.camera, example.T_cam_lidar, reach_px=EVERYWHERE_PX)
    sparse_m, near = clean_map(samples, size), near_samples(samples, size, Completion.reach_px)
    rows, depth_m, error = look(ready, fill, sparse_m, scene.image, near)
    maps = depth_m, fill.depth_m[rows], sparse_m[rows], error, fill.trust()[rows]
    known = near[rows] & (example.weight[rows] > LEAST_WEIGHT)
    asked = choice.find_unsure(maps, known)
    pixels: Pixels = choice.see(maps, np.sort(rng.permutation(asked)[:PER_MAP]))
    each = asked.size / max(1, pixels.at.size) / max(1, int(known.sum()))
    truth_m = example.truth_m[rows].reshape(-1)[pixels.at]
    return pixels.clues, pixels.offered, np.log(truth_m), np.full(truth_m.size, each, np.float32)


def fit(pixels: KnownPixels, seed: int = 0) -> DepthChoice:
    """Fit a choice to pixels by AdamW; the clues' mean and spread go into the first layer."""
    net = RuleNet(pixels.clues, (choice.CLUES, *HIDDEN, choice.OFFERED), seed)
    offered, truth = torch.from_numpy(np.ascontiguousarray(pixels.offered.T)), torch.from_numpy(pixels.truth)
    weight = torch.from_numpy(pixels.weight / pixels.weight.mean())
    optimiser = torch.optim.AdamW(net.net.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=STEPS)
    for step in range(STEPS):
        at = draw_batch(seed, step, len(truth), BATCH)
        chosen = net.choose(at, offered)
        error_m = (chosen.exp() - truth[at].exp()).abs()
        inside = error_m.clamp_max(HUBER_M)
        squared = inside * inside + 2 * HUBER_M * (error_m - inside)
        loss = (weight[at] * (error_m + SQUARED * squared + RELATIVE * (chosen - truth[at]).abs())).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return DepthChoice(net.rule())


def cross_validate(pixels: KnownPixels) -> Iterator[str]:
    """Leave each part out in turn, and say of each source what the choice is worth on scenes that it has not seen."""

    def decide(apart: npt.NDArray[np.bool_]) -> FloatMap:
        return fit(pixels.take(~apart)).decide(pixels.clues[:, apart], pixels.offered[:, apart])

    chosen = leave_out(pixels.offered[0], pixels.part, decide)
    for source in dict.fromkeys(pixels.source.tolist()):
        here = pixels.source == source
        truth, weight = pixels.truth[here], pixels.weight[here]
        before, after = (_figures(found[here], truth, weight) for found in (pixels.offered[0], chosen))
        yield f"{source}, {here.sum()} unsure pixels, left out in turn: {before}; then {after}"


def _figures(found: FloatMap, truth: FloatMap, weight: FloatMap) -> str:
    """Return AbsRel, RMSE and MAE of pixels (n,), logarithms of depths, in words."""
    share, error_m = weight / weight.sum(), np.abs(np.exp(found) - np.exp(truth))
    rmse_m = float(np.sqrt((share * np.square(error_m)).sum()))
    relative = (share * error_m / np.exp(truth)).sum()
    return f"AbsRel {relative:.4f}, RMSE {rmse_m:.2f} m, MAE {(share * error_m).sum():.3f} m"
