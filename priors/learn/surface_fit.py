"""Fit of a surface choice (nets/surface_choice.py), on pairs with truth that training may use.

    priors train surfaces priors/weights/cfnet-s.safetensors --street samples/ --real DATA

The network sees whole pairs: KITTI 2015 and drive 0009 but for what is held back, and street samples. Of each pair some
pixels are drawn that it is unsure of and whose truth is known. The rule learns from the relative error of the depth,
from D1's outliers, and a little from errors in metres and pixels. Before it is fitted to all pairs, a quarter of them
is left out in turn: that says what it is worth on pairs that it has not seen. What is written goes into the header.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from eval.stereo import is_d1
from priors.adapt.views import to_tensor
from priors.errors import DataError
from priors.learn import pair_file
from priors.learn.real_truth import DRIVE, KITTI2015
from priors.learn.rule_net import NEIGHBOURS, PARTS, RuleNet, draw_batch, leave_out
from priors.learn.stereo_data import Folders, find_sources
from priors.learn.stereo_pair import StereoPair
from priors.nets import runtime, surface_choice, weights
from priors.nets.confidence import ConfidenceCalibration
from priors.nets.runtime import Ready, as_map
from priors.nets.surface_choice import HIDDEN, Maps, SurfaceChoice
from priors.types import FloatMap

Matcher = Callable[[StereoPair], Maps]
"""Matches a pair; returns what the choice looks at."""
LARGEST_PX = 192
BELOW = 0.7
"""Pixels of less confidence are fitted to: some more than surfaces are chosen for."""
PER_PAIR = 4000
"""Pixels drawn of each pair."""
SURE = 0.5
"""Labels count where their weight is above this."""
LEAST_PX = 1.0
"""Truth of less disparity is not fitted to; nor is the sky, which the sky mask knows."""
SHARES = {"street": 0.3, KITTI2015: 1.0, DRIVE: 1.0}
"""What a pair of each source weighs. A scanner's truth ends before a near outline, so that near surfaces are right more
often among its pixels than in a street, whose truth is whole: streets hold the rule back from making them wider."""
REACH = 384.0
"""Focal length times baseline, px m: KITTI's, for errors in metres."""
NEAREST_PX = REACH / 250
"""Maps end at 250 m."""
STEPS, BATCH, RATE = 1000, 2048, 5e-3
OUTLIER_WEIGHT, METRE_WEIGHT, PIXEL_WEIGHT = 0.3, 0.0015, 0.01
"""Of an outlier, a metre and a pixel beside a relative error of 1."""
MOST_RELATIVE, MOST_M, MOST_PX = 3.0, 20.0, 30.0
"""Errors above count little more, or no more."""


@dataclass(frozen=True, slots=True)
class UnsurePixels:
    """Pixels of any number of pairs, n in all, whose confidence is below BELOW."""

    clues: FloatMap
    """(CLUES, n), or more of a wide rule."""
    offered_px: FloatMap
    """(OFFERED, n), or more of a wide rule."""
    truth_px: FloatMap
    """(n,)."""
    weight: FloatMap
    """(n,) a pair's known pixels have SHARES of its source in all, these their part of it."""
    part: npt.NDArray[np.int64]
    """(n,) which part the pair is of."""
    source: npt.NDArray[np.str_]
    """(n,) where the pair comes from."""

    def take(self, which: npt.NDArray[np.bool_]) -> "UnsurePixels":
        """Return those where `which` (n,) is True."""
        of_pairs = self.part[which], self.source[which]
        return UnsurePixels(
            self.clues[:, which], self.offered_px[:, which], self.truth_px[which], self.weight[which], *of_pairs
        )


def fit_file(file: Path, folders: Folders, *, wide: bool = False) -> list[str]:
    """Fit the choice of a file of weights, rewriting its header; returns lines that say what it is worth.

    With `wide` the rule may also choose what lies farther away (nets/surface_choice.py).
    DataError where the weights are another kind of network's, or there is nothing to fit to.
    """
    about = weights.read_about(file)
    ready = runtime.open_net(about["net"], about["size"], runtime.choose("auto"), file)
    pixels = collect(matcher_of(ready), find_pairs(folders), SHARES, wide=wide)
    lines = list(cross_validate(pixels))
    weights.rewrite_about(file, **{surface_choice.ENTRY: fit(pixels).record()})
    return lines


def find_pairs(folders: Folders) -> dict[str, Sequence[Path]]:
    """Return the files of the pairs to fit to, by source."""
    train, _ = find_sources(folders)
    return {name: files for name, files in train.drawn().items() if name in SHARES}


def matcher_of(ready: Ready) -> Matcher:
    """Return what a network says of a pair."""
    calibration = ConfidenceCalibration.read(ready.about)

    def look(pair: StereoPair) -> Maps:
        out = ready(to_tensor([pair.left]), to_tensor([pair.right]), largest_px=LARGEST_PX)
        disparity_px, sigma_px, doubt = (as_map(map_) for map_ in (out.disparity_px, out.sigma_px, out.doubt))
        return disparity_px, sigma_px, doubt, calibration(disparity_px, sigma_px, doubt)

    return look


def collect(
    look: Matcher,
    paths: Mapping[str, Sequence[Path]],
    shares: Mapping[str, float],
    *,
    wide: bool = False,
    seed: int = 0,
) -> UnsurePixels:
    """Match pairs and draw pixels of each; DataError where there are none.

    Args:
        look: matches a pair.
        paths: files of pairs, by source.
        shares: what a pair of each source weighs.
        wide: the rule may also choose what lies farther away.
        seed: decides which pixels are drawn.
    """
    rng, parts = np.random.default_rng(seed), []
    for source, files in paths.items():
        for number, path in enumerate(files):
            pair = pair_file.read(path)
            *drawn, weight = _draw(look(pair), pair, rng, wide)
            place = np.full(weight.size, number // NEIGHBOURS % PARTS), np.full(weight.size, source)
            parts.append((*drawn, shares[source] * weight, *place))
    if not parts:
        raise DataError("no pairs with truth to fit to: name samples by --street, and real data by --real")
    return UnsurePixels(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _draw(
    maps: Maps, pair: StereoPair, rng: np.random.Generator, wide: bool
) -> tuple[FloatMap, FloatMap, FloatMap, FloatMap]:
    """Return a pair's clues (CLUES, n), what is offered (OFFERED, n), truth and weights (n,)."""
    truth_px = pair.disparity_px
    known = (pair.weight > SURE) & ~pair.sky & (truth_px > LEAST_PX) & (truth_px < LARGEST_PX - 1)
    unsure = np.flatnonzero(known & (maps[3] < BELOW))
    at = np.sort(rng.permutation(unsure)[:PER_PAIR])
    offered_px, clues = surface_choice.look(maps, pair.left, at, wide=wide)
    each = unsure.size / max(1, at.size) / max(1, int(known.sum()))
    return clues, offered_px, truth_px.reshape(-1)[at], np.full(at.size, each, np.float32)


def fit(pixels: UnsurePixels, seed: int = 0) -> SurfaceChoice:
    """Fit a choice to pixels by Adam; the clues' mean and spread go into the first layer."""
    net = RuleNet(pixels.clues, (len(pixels.clues), *HIDDEN, len(pixels.offered_px)), seed)
    offered_px = torch.from_numpy(np.ascontiguousarray(pixels.offered_px.T))
    truth_px, weight = torch.from_numpy(pixels.truth_px), torch.from_numpy(pixels.weight / pixels.weight.mean())
    optimiser = torch.optim.Adam(net.net.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for step in range(STEPS):
        at = draw_batch(seed, step, len(truth_px), BATCH)
        loss = (weight[at] * cost(net.choose(at, offered_px), truth_px[at])).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net.rule()


def cost(chosen_px: Tensor, truth_px: Tensor) -> Tensor:
    """Return what chosen disparities (n,), px, cost: errors in depth and disparity, and being an outlier."""
    chosen_px = chosen_px.clamp(min=NEAREST_PX)
    error_px = (chosen_px - truth_px).abs()
    relative = (truth_px / chosen_px - 1).abs().clamp(max=MOST_RELATIVE)
    metres = nn.functional.huber_loss(REACH / chosen_px, REACH / truth_px, reduction="none", delta=MOST_M)
    outlier = torch.sigmoid(3 * (error_px / (0.05 * truth_px).clamp(min=3) - 1))
    return relative + OUTLIER_WEIGHT * outlier + METRE_WEIGHT * metres + PIXEL_WEIGHT * error_px.clamp(max=MOST_PX)


def cross_validate(pixels: UnsurePixels) -> Iterator[str]:
    """Leave each part out in turn, and say of each source what the choice is worth on pairs that it has not seen."""

    def decide(apart: npt.NDArray[np.bool_]) -> FloatMap:
        return fit(pixels.take(~apart)).decide(pixels.clues[:, apart], pixels.offered_px[:, apart])

    chosen_px = leave_out(pixels.offered_px[0], pixels.part, decide)
    for source in dict.fromkeys(pixels.source.tolist()):
        here = pixels.source == source
        truth_px, weight = pixels.truth_px[here], pixels.weight[here]
        before, after = (_figures(found[here], truth_px, weight) for found in (pixels.offered_px[0], chosen_px))
        yield f"{source}, {here.sum()} unsure pixels, left out in turn: {before}; then {after}"


def _figures(found_px: FloatMap, truth_px: FloatMap, weight: FloatMap) -> str:
    """Return AbsRel, D1 and RMSE of pixels (n,) in words, metres as KITTI's rig has them."""
    found_px, share = np.maximum(found_px, np.float32(NEAREST_PX)), weight / weight.sum()
    relative = np.abs(truth_px / found_px - 1)
    metres = REACH / found_px - REACH / truth_px
    outlier = is_d1(np.abs(found_px - truth_px), truth_px)
    rmse_m = float(np.sqrt((share * np.square(metres)).sum()))
    return f"AbsRel {(share * relative).sum():.3f}, D1 {100 * (share * outlier).sum():.1f} %, RMSE {rmse_m:.2f} m"
