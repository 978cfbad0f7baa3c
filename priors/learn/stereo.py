"""Train a stereo network: from the street's pairs, from pairs made of single real images, from real pairs with labels.

    priors train stereo --street samples/ --out runs/cfnet-s          stops and goes on at any time

The loss: absolute error of every stage's disparity, cross-entropy of every stage's matching distribution (so that its
spread is what the error is: the next stage's range and the confidence rest on it), and of the confidence.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.adapt.batch import Batch
from priors.adapt.objective import masked_mean
from priors.draw.colours import colour_depth
from priors.learn.stereo_data import collate
from priors.learn.stereo_pair import Item
from priors.nets.stereo_output import Matched, StereoOut
from priors.types import Image

LARGEST_PX = 192
SHARP_PX = 0.25
"""Errors below this are squared."""
SKY_WEIGHT = 0.1
"""Of a pixel of the sky, whose disparity is 0: what stands before it is pulled away with it, to hundreds of metres."""
STAGE_WEIGHTS = (0.1, 0.3, 0.5)
SPREAD_WEIGHT, DOUBT_WEIGHT = 0.3, 0.2
SCHEDULE = (2500, 3300)
"""Steps from which the second and the third stage learn too: the first one is a third of the work."""


class StereoTask:
    """What a stereo network learns; see loop.Task."""

    def __init__(
        self,
        net: nn.Module,
        draw: Callable[[np.random.Generator], Item],
        held_back: Sequence[Item] = (),
        size: int = 2,
        schedule: tuple[int, int] = SCHEDULE,
    ) -> None:
        """Take a network, what draws a training item, items to validate on, how many items make a batch, and the
        steps at which the second and the third stage join."""
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
        truth, weight = batch["disparity_px"], batch["weight"] * batch["known"]
        weight = weight * (truth < LARGEST_PX) * (1 - (1 - SKY_WEIGHT) * batch["sky"])
        error = (out.disparity_px - truth).abs()
        total = masked_mean(soft(error), weight) if stages == 3 else error.new_zeros(())
        spread = total.new_zeros(())
        for stage, share in zip(out.stages, STAGE_WEIGHTS, strict=False):
            step = truth.shape[-1] // stage.disparity_px.shape[-1]
            target, sure = (values[:, step // 2 :: step, step // 2 :: step] for values in (truth, weight))
            total = total + share * masked_mean(soft(step * stage.disparity_px - target), sure)
            spread = spread + cross_entropy(stage, target / step, sure)
        total = total + SPREAD_WEIGHT * spread
        terms = {"epe": masked_mean(error, weight).detach(), "spread": spread.detach()}
        if stages < 3:
            return total, terms
        doubt = F.binary_cross_entropy_with_logits(out.doubt, (error.detach() > 1).float(), reduction="none")
        return total + DOUBT_WEIGHT * masked_mean(doubt, weight), terms

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Return EPE, D1 and the share above 1 px by source, without sky; "error" is the mean EPE, each at most 5."""
        found: dict[str, list[tuple[float, float, float]]] = {}
        for item in self._held_back:
            error, truth = predict(net, item)[0] - item["disparity_px"], item["disparity_px"]
            sure = item["known"] & ~item["sky"] & (item["weight"] > 0) & (truth < LARGEST_PX)
            error, truth = np.abs(error[sure]), truth[sure]
            wrong = (error > 3) & (error > 0.05 * truth)
            found.setdefault(item["source"], []).append((error.mean(), wrong.mean(), (error > 1).mean()))
        result: dict[str, float] = {}
        for source, rows in found.items():
            values = np.mean(rows, axis=0)
            result.update({f"{source} {name}": float(v) for name, v in zip(("epe", "d1", "bad1"), values, strict=True)})
        epes = [min(5.0, value) for name, value in result.items() if name.endswith("epe")]
        return {"error": float(np.mean(epes)) if epes else 0.0, **result}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw left image, disparity and confidence of an item of each source."""
        shown: dict[str, Image] = {}
        for item in self._held_back:
            if item["source"] in shown:
                continue
            disparity, doubt = predict(net, item)
            left = (item["left"].transpose(1, 2, 0) * 255).astype(np.uint8)
            sure = cv2.cvtColor((255 / (1 + np.exp(doubt))).astype(np.uint8), cv2.COLOR_GRAY2RGB)
            coloured = colour_depth((400 / np.maximum(disparity, 0.5)).astype(np.float32), 4.0, 100.0)
            truth_m = np.where(item["known"], 400 / np.maximum(item["disparity_px"], 0.5), 0).astype(np.float32)
            truth = colour_depth(truth_m, 4.0, 100.0)
            shown[item["source"]] = np.concatenate([left, truth, coloured, sure])
        return shown


def predict(net: nn.Module, item: Item) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return disparity and doubt (h, w) of one item."""
    device = next(net.parameters()).device
    pair = [torch.from_numpy(np.ascontiguousarray(item[side]))[None].to(device) for side in ("left", "right")]
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16):
        out: StereoOut = net(*pair, LARGEST_PX)
    return out.disparity_px[0].float().cpu().numpy(), out.doubt[0].float().cpu().numpy()


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
