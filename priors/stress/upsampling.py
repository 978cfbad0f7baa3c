"""Rows of the table: convex upsampling, upsampling of volumes, the correction of a pre-fill, rounding to 8 bits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from priors.nets import mffnet, upsample
from priors.nets.blocks import UpsampleConv
from priors.nets.fused import fuse
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import NO_HALF, NO_MASK, NO_POSES, Case, Outputs, Routine, without
from priors.stress.volumes import PLAIN

FACTOR = 4
LARGEST_LOGIT = 30.0
LARGEST_CHANGE = mffnet.LARGEST_CHANGE


def convex_upsampling(of: str) -> Callable[[Given], Case]:
    """Return the case of fine pixels as averages of 3x3 coarse ones; extreme are the values or the weights' logits."""

    def case(given: Given) -> Case:
        height, width = given.size(4, 6)
        room, more = (1, height, width), (FACTOR**2 * 9, height, width)
        values = given.values(1, 60, room) if of == "values" else given.plain(1, 60, room)
        make = given.values if of == "logits" else given.plain
        logits = make(0.1, 29, more, signed=True)
        ours = torch.from_numpy(values.astype(np.float32))[None], given.precision.tensor(logits)[None]

        def found() -> Outputs:
            with torch.no_grad():
                return {"fine": upsample.convex(*ours, FACTOR)[0]}

        with np.errstate(all="ignore"):
            sizes = _averages(np.where(np.isfinite(values), abs(values), 0), logits)
        return Case(found, lambda: {"fine": _averages(values, logits)}, {"fine": sizes}, spreads=True)

    return case


def _averages(values: Floats, logits: Floats) -> Floats:
    """Return the averages (c, h * FACTOR, w * FACTOR) of values (c, h, w): see priors/nets/upsample.py."""
    _, height, width = logits.shape
    held = np.clip(logits.reshape(FACTOR, FACTOR, 9, height, width), -LARGEST_LOGIT, LARGEST_LOGIT)
    share = np.exp(held.astype(np.longdouble))
    share /= share.sum(axis=2, keepdims=True)
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), mode="edge")
    around = [padded[:, y : y + height, x : x + width] for y in range(3) for x in range(3)]
    near = np.stack(around).astype(np.longdouble)
    fine = np.einsum("abkhw,kchw->chawb", share, near)
    return np.asarray(fine.reshape(len(values), height * FACTOR, width * FACTOR), np.float64)


def volume_upsampling(given: Given) -> Case:
    """Repeat a volume to twice its size, convolve it, and add another one."""
    inputs, outputs = 8, 6
    small_size = (inputs, *given.size(2, 3, 4))
    big_size = (outputs, *(2 * side for side in small_size[1:]))
    small, plus = given.values(0.1, 2, small_size, signed=True), given.plain(0.1, 2, big_size, signed=True)
    weight = given.precision.rounded(given.random.normal(0, 0.1, (outputs, inputs, 3, 3, 3)))
    bias = given.precision.rounded(given.random.normal(0, 0.1, outputs))
    layer = nn.Conv3d(inputs, outputs, 3, padding=1).requires_grad_(False)
    ours = [given.precision.tensor(x)[None].to(memory_format=torch.channels_last_3d) for x in (small, plus)]

    def found() -> Outputs:
        layer.weight.data, layer.bias.data = (given.precision.tensor(x) for x in (weight, bias))  # type: ignore[union-attr]
        with torch.no_grad():
            (block,) = fuse(nn.ModuleList([UpsampleConv(layer, nn.ReLU())]))
            return {"volume": block(*ours)[0]}

    exact = [torch.from_numpy(np.ascontiguousarray(x)) for x in (small, weight, bias, plus)]

    def wanted() -> Outputs:
        return {"volume": _upsampled(*exact)}

    sizes = _upsampled(*(each.nan_to_num(0, 0, 0).abs() for each in exact))
    return Case(found, wanted, {"volume": sizes.numpy()}, spreads=True)


def _upsampled(small: Any, weight: Any, bias: Any, plus: Any) -> Any:
    """Do the same as one reads it, in float64."""
    repeated = small[None].repeat_interleave(2, 2).repeat_interleave(2, 3).repeat_interleave(2, 4)
    return plus + torch.relu(nn.functional.conv3d(repeated, weight, bias, padding=1))[0]


def depth_correction(given: Given) -> Case:
    """Change a pre-filled depth map by what a network says."""
    height, width = given.size(8, 12)
    rows, columns = -(-height // 2), -(-width // 2)
    raw = given.values(0.05, 2, (16, rows, columns), signed=True)
    depth_m = given.plain(1, 80, (height, width))
    log_fill = np.log(depth_m).astype(np.float32).astype(np.float64)
    ours = given.precision.tensor(raw)[None], torch.from_numpy(log_fill.astype(np.float32))[None]

    def found() -> Outputs:
        with torch.no_grad():
            depth, scale = mffnet.correct_fast(*ours)
        return {"depth": depth[0], "scale": scale[0]}

    def wanted() -> Outputs:
        first, second, choice, scale = (_shuffled(raw[4 * n : 4 * n + 4])[:height, :width] for n in range(4))
        share = 1 / (1 + np.exp(-np.clip(choice, -1000, 1000)))
        first, second = np.where(share > 0, first, 0), np.where(share < 1, second, 0)
        change = np.clip(share * first + (1 - share) * second, -LARGEST_CHANGE, LARGEST_CHANGE)
        return {"depth": np.exp(log_fill + change), "scale": scale}

    return Case(found, wanted, spreads=True)


def _shuffled(cells: Floats) -> Floats:
    """Put the four values of each cell (4, h, w) to their places: (2 h, 2 w)."""
    _, height, width = cells.shape
    return cells.reshape(2, 2, height, width).transpose(2, 0, 3, 1).reshape(2 * height, 2 * width)


NO_RELU = without("inf", "NaN", why="oneDNN's ReLU makes 0 of what is no number: its answer is not ours")
ROUTINES = (
    Routine(
        "convex upsampling", "priors/nets/upsample.py", convex_upsampling("values"), {**NO_POSES, **NO_MASK}, NO_HALF
    ),
    Routine("convex upsampling's weights", "priors/nets/upsample.py", convex_upsampling("logits"), PLAIN, NO_HALF),
    Routine("volume upsampling", "priors/nets/fused.py", volume_upsampling, {**PLAIN, **NO_RELU}, NO_HALF),
    Routine("depth correction", "priors/nets/mffnet.py", depth_correction, PLAIN, NO_HALF),
)
