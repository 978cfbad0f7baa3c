"""Rows of the table: cost volumes, their gradients, and the mean and deviation of a matching distribution."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from priors.nets import matching
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_DEPTH, NO_HALF, NO_MASK, NO_POSES, Case, Gradient, Outputs, Routine

ROWS, COLUMNS, CHANNELS, GROUPS, PLANES = 3, 19, 16, 4, 6
SOFT = 1e-4
"""Added to the square of a feature's length."""
MOST_PX = 12.0


def cost_volume(given: Given) -> Case:
    """Match features with extreme values."""
    left, right = (given.values(0.05, 3, _features(given), signed=True) for _ in range(2))
    return _matched(given, left, right, _disparities(given))


def cost_volume_anywhere(given: Given) -> Case:
    """Match usual features at extreme disparities: outside the other image there is no match."""
    left, right = (given.plain(0.05, 3, _features(given), signed=True) for _ in range(2))
    height, width, _ = _features(given)
    return _matched(given, left, right, given.values(0.5, MOST_PX, (height, width, PLANES), signed=True))


def _features(given: Given) -> tuple[int, int, int]:
    height, width = given.size(ROWS, COLUMNS)
    return height, width, CHANNELS


def _disparities(given: Given) -> Floats:
    height, width, _ = _features(given)
    return given.precision.rounded(given.random.uniform(-1, MOST_PX, (height, width, PLANES)))


def _matched(given: Given, left: Floats, right: Floats, disparity_px: Floats) -> Case:
    ours = [given.precision.tensor(side.transpose(2, 0, 1))[None] for side in (left, right)]
    at = torch.from_numpy(disparity_px.astype(np.float32))[None]

    def found() -> Outputs:
        with torch.no_grad():
            volume = matching.lookup(ours[0], ours[1], at, GROUPS)
        assert isinstance(volume, torch.Tensor)
        return {"matches": volume[0].permute(1, 2, 3, 0)}

    def wanted() -> Outputs:
        return {"matches": look_up(unit(left), unit(right), disparity_px)}

    return Case(found, wanted, scale={"matches": 1.0}, spreads=True)


def cost_volume_gradient(given: Given) -> Case:
    """Match unit features in training: by the features and by the disparities there is a gradient."""
    sides = {name: unit(given.values(0.05, 3, _features(given), signed=True)) for name in ("left", "right")}
    at = {name: given.precision.rounded(side) for name, side in sides.items()}
    at["disparity"] = _disparities(given)
    pull = given.random.normal(size=(*at["disparity"].shape, GROUPS))
    leaves = {name: torch.from_numpy(side.astype(np.float32))[None].requires_grad_() for name, side in at.items()}

    def matched() -> torch.Tensor:
        return matching.lookup_units(leaves["left"], leaves["right"], leaves["disparity"], GROUPS)[0].permute(
            1, 2, 3, 0
        )

    def gradients() -> Outputs:
        with torch.enable_grad():
            found = torch.autograd.grad((matched() * torch.from_numpy(pull).float()).sum(), list(leaves.values()))
        return {name: slope[0] for name, slope in zip(leaves, found, strict=True)}

    def loss(moved: Any) -> Floats:
        return (look_up(moved["left"], moved["right"], moved["disparity"]) * pull).ravel()

    def wanted() -> Outputs:
        return {"matches": look_up(*at.values())}

    return Case(lambda: {"matches": matched()}, wanted, {"matches": 1.0}, Gradient(gradients, loss, at), spreads=True)


def unit(features: Floats) -> Floats:
    """Return features (h, w, c) with every group of channels of length 1."""
    split = features.reshape(*features.shape[:2], GROUPS, -1).astype(np.longdouble)
    with np.errstate(all="ignore"):
        length = np.sqrt((split**2).sum(-1, keepdims=True) + np.longdouble(SOFT))
        return np.asarray((split / length).reshape(features.shape), np.float64)


def look_up(left: Floats, right: Floats, disparity_px: Floats) -> Floats:
    """Multiply unit features (h, w, c) at disparities (h, w, planes): (h, w, planes, groups); 0 outside."""
    height, width, planes = disparity_px.shape
    column = np.arange(width)[:, None] - disparity_px
    inside = (column >= 0) & (column <= width - 1)
    held = np.where(inside, column, 0)
    first = np.minimum(np.floor(held), max(0, width - 2)).astype(int)
    share = (held - first)[..., None]
    row = np.arange(height)[:, None, None]
    theirs = right[row, first] * (1 - share) + right[row, np.minimum(first + 1, width - 1)] * share
    products = (left[:, :, None] * theirs).reshape(height, width, planes, GROUPS, -1).sum(-1)
    products[~inside] = 0  # a disparity that is no number names no place
    return np.asarray(products)


def soft_argmin(window: int | None) -> Callable[[Given], Case]:
    """Return the case of the mean of a matching distribution, over some planes around the likeliest or over all."""
    return lambda given: _expected(given, window)


def _expected(given: Given, window: int | None) -> Case:
    height, width = given.size(ROWS, COLUMNS)
    planes = 12
    logits = given.values(0.1, 6, (height, width, planes), signed=True)
    positions = given.precision.rounded(np.sort(given.random.uniform(0, 40, (height, width, planes)), axis=2))
    ours, at = given.precision.tensor(logits)[None], torch.from_numpy(positions.astype(np.float32))[None]

    def found() -> Outputs:
        with torch.no_grad():
            mean, sigma = matching.expect(ours, at, window)
        return {"mean": mean[0], "sigma": sigma[0]}

    return Case(found, lambda: _distribution(logits, positions, window), scale={"mean": 40.0}, spreads=True)


def _distribution(logits: Floats, positions: Floats, window: int | None) -> Outputs:
    """Return mean and deviation of softmax(logits) over positions; see priors/nets/cost_volume.py."""
    share = np.exp(logits.astype(np.longdouble) - logits.max(-1, keepdims=True))
    plane = np.arange(logits.shape[-1])
    near = abs(plane - logits.argmax(-1)[..., None]) <= (len(plane) if window is None else window)
    mean = (share * near * positions).sum(-1) / (share * near).sum(-1)
    variance = (share * (positions - mean[..., None]) ** 2).sum(-1) / share.sum(-1)
    return {"mean": mean, "sigma": np.sqrt(variance + np.longdouble(1e-6))}


PLAIN = {**NO_POSES, **NO_MASK, **NO_DEPTH}
ROUTINES = (
    Routine("cost volume", "priors/nets/matching.py", cost_volume, PLAIN, NO_HALF),
    Routine("cost volume's disparities", "priors/nets/matching.py", cost_volume_anywhere, PLAIN, NO_HALF),
    Routine("cost volume in training", "priors/nets/matching.py", cost_volume_gradient, PLAIN, FLOAT32_ONLY),
    Routine("soft-argmin and variance", "priors/nets/matching.py", soft_argmin(None), PLAIN, NO_HALF),
    Routine("soft-argmin near the likeliest", "priors/nets/matching.py", soft_argmin(2), PLAIN, NO_HALF),
)
