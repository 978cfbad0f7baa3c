"""Training of a stereo network: on the street's pairs, on pairs made of single real images, on real pairs with labels.

    priors train stereo runs/cfnet-s --street samples/          stops and goes on at any time

The loss: absolute error of every stage's disparity, and of the last one's depth (see `depth_error`), cross-entropy of
every stage's matching distribution (so that its spread is what the error is: the next stage's range and the confidence
rest on it), and of the confidence.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.adapt.objective import masked_mean
from priors.adapt.training_step import Batch
from priors.adapt.views import to_tensor
from priors.codecs import as_rgb
from priors.draw.colours import colour_depth
from priors.learn.stereo_data import Draw, collate
from priors.learn.stereo_pair import StereoPair
from priors.nets.stereo_output import Matched, StereoOut
from priors.types import FloatMap, Image

LARGEST_PX = 192
SHARP_PX = 0.25
"""Errors below this are squared."""
TIE = 1e-3
"""Of a pixel's weight, what the middle of a cell is ahead of its corner."""
FIGURES = ("epe", "d1", "bad1", "far2")
"""EPE, D1, the share above 1 px, and the share more than twice too far."""
VALIDATED_PX = 1.5
"""KITTI's disparity at 250 m, where maps end."""
VALIDATED = 0.3
"""Labels of less weight are not validated on."""
SKY_WEIGHT = 0.1
"""Of a pixel of the sky, whose disparity is 0: what stands before it is pulled away with it, to hundreds of metres."""
DEPTH_WEIGHT = 10.0
"""Of the relative error of the depth."""
FARTHER, LEAST_PX = 4.0, 4.0
"""How many times too far a pixel is counted at most; disparities below count as this, for their depth is noise."""
STAGE_WEIGHTS = (0.1, 0.3, 0.5)
SPREAD_WEIGHT, DOUBT_WEIGHT = 0.3, 0.2
SCHEDULE = (2500, 3300)
"""Steps from which the second and the third stage learn too: the first one is a third of the work."""


class StereoTask:
    """What a stereo network learns; see loop.Task."""

    def __init__(
        self,
        net: nn.Module,
        draw: Draw,
        held_back: Sequence[StereoPair] = (),
        size: int = 2,
        schedule: tuple[int, int] = SCHEDULE,
    ) -> None:
        """Make a task.

        Args:
            net: the network.
            draw: draws a training pair.
            held_back: pairs to validate on.
            size: how many pairs make a batch.
            schedule: the steps at which the second and the third stage join.
        """
        self.net, self._draw, self._held_back, self._size = net, draw, held_back, size
        self._schedule = schedule

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Draw a batch (see data.collate), and how many stages learn from it."""
        stages = 1 + sum(step >= first for first in self._schedule)
        return collate([self._draw(rng) for _ in range(self._size)]) | {"stages": torch.tensor(stages)}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, and the final disparity's mean absolute error in pixels."""
        stages = int(batch.get("stages", 3))
        out: StereoOut = self.net(batch["left"], batch["right"], LARGEST_PX, stages)
        truth, weight = batch["disparity_px"], batch["weight"]
        weight = weight * (truth < LARGEST_PX) * (1 - (1 - SKY_WEIGHT) * batch["sky"])
        error = (out.disparity_px - truth).abs()
        total = masked_mean(soft(error), weight) if stages == 3 else error.new_zeros(())
        if stages == 3:
            total = total + DEPTH_WEIGHT * masked_mean(depth_error(out.disparity_px, truth), weight)
        spread = total.new_zeros(())
        for stage, share in zip(out.stages, STAGE_WEIGHTS, strict=False):
            step = truth.shape[-1] // stage.disparity_px.shape[-1]
            target, sure = coarser(truth, weight, step)
            total = total + share * masked_mean(soft(step * stage.disparity_px - target), sure)
            spread = spread + cross_entropy(stage, target / step, sure)
        total = total + SPREAD_WEIGHT * spread
        terms = {"epe": masked_mean(error, weight).detach(), "spread": spread.detach()}
        if stages < 3:
            return total, terms
        doubt = F.binary_cross_entropy_with_logits(out.doubt, (error.detach() > 1).float(), reduction="none")
        return total + DOUBT_WEIGHT * masked_mean(doubt, weight), terms

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return FIGURES by source, without sky; "error" is the mean EPE, each at most 5."""
        by_source: dict[str, list[tuple[float, ...]]] = {}
        for pair in self._held_back:
            error, truth = predict(net, pair)[0] - pair.disparity_px, pair.disparity_px
            sure = (pair.weight > VALIDATED) & ~pair.sky & (truth < LARGEST_PX)
            error, truth = error[sure], truth[sure]
            farther = truth / np.maximum(truth + error, VALIDATED_PX) > 2
            error = np.abs(error)
            wrong = (error > 3) & (error > 0.05 * truth)
            by_source.setdefault(pair.source, []).append(
                (error.mean(), wrong.mean(), (error > 1).mean(), farther.mean())
            )
        result: dict[str, float] = {}
        for source, rows in by_source.items():
            values = np.mean(rows, axis=0)
            result.update({f"{source} {name}": float(v) for name, v in zip(FIGURES, values, strict=True)})
        epes = [min(5.0, value) for name, value in result.items() if name.endswith("epe")]
        return {"error": float(np.mean(epes)) if epes else 0.0, **result}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw left image, truth, disparity and confidence of a pair of each source."""
        shown: dict[str, Image] = {}
        for pair in self._held_back:
            if pair.source in shown:
                continue
            disparity, doubt = predict(net, pair)
            sure = cv2.cvtColor((255 / (1 + np.exp(doubt))).astype(np.uint8), cv2.COLOR_GRAY2RGB)
            coloured = colour_depth((400 / np.maximum(disparity, 0.5)).astype(np.float32), 4.0, 100.0)
            truth_m = np.where(pair.known, 400 / np.maximum(pair.disparity_px, 0.5), 0).astype(np.float32)
            truth = colour_depth(truth_m, 4.0, 100.0)
            shown[pair.source] = np.concatenate([as_rgb(pair.left), truth, coloured, sure])
        return shown


def predict(net: nn.Module, pair: StereoPair) -> tuple[FloatMap, FloatMap]:
    """Return disparity and doubt (h, w) of one pair."""
    device = next(net.parameters()).device
    views = [to_tensor([view]).to(device) for view in (pair.left, pair.right)]
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16):
        out: StereoOut = net(*views, LARGEST_PX)
    return out.disparity_px[0].float().cpu().numpy(), out.doubt[0].float().cpu().numpy()


def depth_error(disparity_px: Tensor, truth_px: Tensor) -> Tensor:
    """Return a loss with the slope of depth's relative error, |truth / disparity - 1|.

    Where a pixel may be of two surfaces, an error in pixels is the same for both; in metres it is much larger for the
    near one that is taken for the far one. On pairs of KITTI 2015, 0.15 % of the pixels were more than five times too
    far, and made up a third of the relative error. The weight is not differentiated: the slope stays finite.
    """
    at_px = torch.maximum(disparity_px.detach(), truth_px / FARTHER).clamp(min=LEAST_PX)
    return truth_px / at_px.square() * (disparity_px - truth_px).abs()


def coarser(truth_px: Tensor, weight: Tensor, step: int) -> tuple[Tensor, Tensor]:
    """Return truth and weight (b, h / step, w / step) as one pixel of each cell of step x step has them.

    It is the pixel of the greatest weight, of equal ones the nearest to the middle: real truth is known on a fifth of
    the pixels, and most middles have none.
    """
    away = (torch.arange(step, device=weight.device) - step // 2).square().float()
    nearness = 1 - (away[:, None] + away) / (2 * step**2)
    rows, columns = (weight.shape[side] // step for side in (-2, -1))
    order = weight + TIE * nearness.repeat(rows, columns)
    _, index = F.max_pool2d(order[:, None], step, return_indices=True)
    return tuple(map_.flatten(1).gather(1, index.flatten(1)).view(-1, rows, columns) for map_ in (truth_px, weight))  # type: ignore[return-value]


def soft(error: Tensor) -> Tensor:
    """Return the absolute value, rounded off below SHARP_PX."""
    size = error.abs()
    return torch.where(size < SHARP_PX, 0.5 * size.square() / SHARP_PX, size - 0.5 * SHARP_PX)


def cross_entropy(stage: Matched, target_px: Tensor, weight: Tensor) -> Tensor:
    """Return how surprising the truth (b, h, w), in the stage's pixels, is to its matching distribution.

    The truth is shared between the two planes beside it; where no plane is near it does not count.
    """
    if stage.logits is None or stage.position_px is None:
        return weight.new_zeros(())
    position = stage.position_px.detach().expand_as(stage.logits)
    first, last = position[..., 0], position[..., -1]
    step = (last - first) / (position.shape[-1] - 1)
    place = (target_px - first) / step
    inside = (place >= -0.5) & (place <= position.shape[-1] - 0.5)
    place = place.clamp(0, position.shape[-1] - 1)
    planes = torch.arange(position.shape[-1], device=position.device)
    share = (1 - (planes - place[..., None]).abs()).clamp(min=0)
    surprise = -(share * stage.logits.float().log_softmax(-1)).sum(-1)
    return masked_mean(surprise, weight * inside)
