"""Figures of held-out views without a run's folder: what fits under stress and the field benchmarks are compared by."""

import tempfile
from pathlib import Path

import numpy as np

from nerf.config import FitConfig
from nerf.fit import OnStep, fit
from nerf.model import Model
from nerf.scene import Scene
from nerf.truths import Truths

FARTHEST_M = 80.0
"""Truth beyond this is not compared, metres."""


def score(scene: Scene, truths: Truths, model: Model) -> tuple[float, float]:
    """Return PSNR, dB, and AbsRel of the held-out views: means over the views, without a crop; no truth: NaN."""
    psnr, abs_rel = [], []
    for position in scene.test:
        view = model.render(scene.T_world_cam[position], scene.camera)
        psnr.append(-10 * np.log10(np.mean((np.clip(view.rgb, 0, 1) - scene.images[position] / 255) ** 2)))
        truth = truths(scene.ids[position])
        if truth is not None:
            known = (truth.depth_m > 0) & (truth.depth_m < FARTHEST_M)
            off_m = np.abs(np.clip(view.depth_m[known], 1e-3, FARTHEST_M) - truth.depth_m[known])
            abs_rel.append(np.mean(off_m / truth.depth_m[known]))
    return float(np.mean(psnr)), float(np.mean(abs_rel)) if abs_rel else np.nan


def fitted(
    scene: Scene, truths: Truths, config: FitConfig, on_step: OnStep = lambda status: None
) -> tuple[float, float]:
    """Fit a scene in a temporary folder, and return the figures of the held-out views; DataError where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        return score(scene, truths, fit(scene, config, Path(folder), on_step))
