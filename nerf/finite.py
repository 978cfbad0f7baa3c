"""Finds NaN and infinity in a fit, and what caused them: a frame's input, or a setting.

Once a gradient is NaN, every parameter soon is. A look at a step's losses is enough to see it, and a look at all
tensors tells whether a checkpoint is good.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerf.config import FitConfig
from nerf.model import StepResult
from nerf.scene import Scene
from priors.errors import DataError

HUGE_M = 1e5
"""No surface is farther, metres; such depths are errors of a file or of its scale."""
TILTED = 1e-2
"""How far R^T R of a rotation R may be from the identity."""
STRANGE = 10.0
"""A setting that is so many times the usual one, or a share of it, is worth naming."""


class NotFiniteError(DataError):
    """A fit whose loss is no number any more: its model must not replace a good checkpoint."""


def bad_terms(result: StepResult) -> dict[str, float]:
    """Return the losses of a step that are no finite numbers; on a GPU this waits for the step to end."""
    values = {name: float(value) for name, value in {**result.terms, "sum": result.total}.items()}
    return {name: value for name, value in values.items() if not math.isfinite(value)}


def bad_tensor(state: Mapping[str, Tensor]) -> str | None:
    """Return the name of the first tensor that holds NaN or infinity; None where all are finite."""
    floating = {name: tensor for name, tensor in state.items() if tensor.is_floating_point()}
    return next((name for name, tensor in floating.items() if not _is_finite(tensor)), None)


def _is_finite(tensor: Tensor) -> bool:
    """Tell whether all values are finite. NaN and infinity show in the sum, which is one fast pass; so may overflow."""
    return math.isfinite(float(tensor.sum())) or bool(torch.isfinite(tensor).all())


def cause(scene: Scene, config: FitConfig) -> str:
    """Say what most likely made a loss infinite or NaN, and what to do about it."""
    return next(_inputs(scene), None) or _setting(config)


def _inputs(scene: Scene) -> Iterator[str]:
    """Name what cannot be right in the training frames."""
    if not np.isfinite(scene.camera.K).all():
        yield f"the camera matrix is not finite ({scene.camera.K.tolist()}): mend the calibration"
    for position in scene.train:
        fault = _pose_fault(scene, position) or _image_fault(scene, position) or _prior_fault(scene, position)
        if fault:
            yield f"frame {scene.ids[position]}: {fault}"


def _pose_fault(scene: Scene, position: int) -> str | None:
    pose = scene.T_world_cam[position]
    if not np.isfinite(pose).all():
        return "its pose is not finite: mend it, or leave the frame out by --frames"
    off = float(np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max())
    if off > TILTED:
        return f"its pose is no rotation (R^T R is off by {off:.2g}): mend it, or leave the frame out by --frames"
    return None


def _image_fault(scene: Scene, position: int) -> str | None:
    image = np.asarray(scene.images[position])
    return None if np.isfinite(image).all() else "its image holds values that are not finite: mend it"


def _prior_fault(scene: Scene, position: int) -> str | None:
    if scene.depth_m is not None:
        depth_m = np.asarray(scene.depth_m[position])
        largest_m = float(np.max(depth_m, where=np.isfinite(depth_m), initial=0))
        if largest_m > HUGE_M:
            return f"its prior has depths up to {largest_m:.3g} m: build the prior again, or use --clip 80"
    if scene.weight is not None and not np.isfinite(np.asarray(scene.weight[position])).all():
        return "its prior's confidence is not finite: build the prior again"
    return None


def _setting(config: FitConfig) -> str:
    """Name the setting that is farthest from the usual one, by its ratio."""
    strange = []
    for group, flag in (("losses", "--{}"), ("optimiser", "optimiser.{}")):
        usual, found = asdict(type(getattr(config, group))()), asdict(getattr(config, group))
        for name, value in found.items():
            ratio = _ratio(value, usual[name])
            if ratio >= STRANGE:
                written = flag.format(name.replace("_", "-") if group == "losses" else name)
                strange.append((ratio, f"{written} {value:g} is far from the usual {usual[name]:g}: choose one nearer"))
    if strange:
        return max(strange)[1]
    return "no input and no setting stands out: try another --seed, or a smaller --depth-weight"


def _ratio(value: Any, usual: Any) -> float:
    """Return how many times a number is the usual one, or the usual one is it; 1 for what cannot be compared."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not (value > 0 and usual > 0):
        return 1.0
    return max(value / usual, usual / value)
