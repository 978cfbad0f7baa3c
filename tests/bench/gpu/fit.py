"""Fits of the packed drive, sparse views, stereo prior: held-out PSNR and AbsRel against time."""

import tempfile
import time
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from eval.image import ImageScore
from eval.protocol import preset
from eval.result import Comparison, score_frame
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.losses import LossConfig
from nerf.model import Model
from nerf.scene import Scene
from nerf.types import RenderedView
from priors import codecs
from tests.bench.gpu.pack import open_pack, truth_path
from tests.bench.gpu.parts import note

SCORING_S = 10.0
"""What must be left besides a fit's own time, to carve before it and to render and score after it."""


@dataclass(frozen=True)
class Asked:
    """One fit; each has the learning rate's whole course, as `nerf fit` has."""

    rays: int
    steps: int | None = None
    seconds: float | None = None

    @property
    def name(self) -> str:
        """What the table calls it."""
        return f"{self.rays} rays, " + (f"{self.steps} steps" if self.steps else f"{self.seconds:g} s")


FITS = (
    Asked(1024, steps=1500),  # as in docs/nerf.md: there on a CPU
    Asked(1024, seconds=5),
    Asked(1024, seconds=15),
    Asked(1024, seconds=60),
    Asked(8192, seconds=15),
    Asked(8192, seconds=60),
)
"""The most wanted first; what no longer fits into the budget is left out."""


def run(options: Namespace) -> None:
    """Fit, score, note; in a short run every fit is as much shorter as the budget is."""
    rehearsal = options.device == "cpu"
    with tempfile.TemporaryDirectory() as folder:
        scene = open_pack(options.pack, Path(folder) / "scenes")
        size = f"{scene.camera.size[1]}x{scene.camera.size[0]}"
        note(drive=scene.name, size=size, views=f"{len(scene.train)} training, {len(scene.test)} held out")
        note(truth="the frame's own LiDAR sweep", prior="stereo", loss="mse")
        if rehearsal:
            scene = replace(scene, test=scene.test[len(scene.test) // 2 :][:1])
            note(left_out="all held-out views but one, and most of the steps")
        began = time.perf_counter()
        config = FitConfig(ModelConfig("ngp"), LossConfig(loss="mse"), steps=20)
        fit(scene, config, Path(folder) / "warm", device=options.device)
        note(carving_and_compiling_s=round(time.perf_counter() - began, 1))
        for i, asked in enumerate(_shorter(asked, options.scale, rehearsal) for asked in FITS):
            left_s = options.deadline - time.time()
            if left_s < (asked.seconds or 0) + SCORING_S:
                note(**{f"left out, {asked.name}": f"{left_s:.0f} s were left"})
                continue
            _one(scene, asked, Path(folder) / str(i), options)


def _shorter(asked: Asked, scale: float, rehearsal: bool) -> Asked:
    """Scale a fit's time; its steps only where nothing is measured."""
    if asked.steps is not None:
        return replace(asked, steps=40) if rehearsal else asked
    return replace(asked, seconds=round((asked.seconds or 0) * scale, 2))


def _one(scene: Scene, asked: Asked, run: Path, options: Namespace) -> None:
    """Make one fit and note what it scores."""
    model, losses = ModelConfig("ngp"), LossConfig(loss="mse")
    config = FitConfig(model, losses, rays=asked.rays, rays_growth=1.0, steps=asked.steps, seconds=asked.seconds)
    last: list[Status] = []

    def keep(status: Status) -> None:
        last[:] = [status]

    if options.device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    model = fit(scene, config, run, keep, options.device)
    status = last[0]
    figures: dict[str, Any] = {
        "steps": status.step,
        "train_s": round(status.elapsed_s, 2),
        "rays/s": round(status.step * asked.rays / status.elapsed_s),
        "samples a ray": round(status.samples / status.rays, 1),
    }
    note(**{asked.name: figures})
    began = time.perf_counter()
    figures |= score(scene, model, options.pack, options.out)
    figures["render_s"] = round((time.perf_counter() - began) / len(scene.test), 2)
    if options.device == "cuda":
        figures["GPU GiB"] = round(torch.cuda.max_memory_allocated() / 2**30, 2)
    note(**{asked.name: figures})


def score(scene: Scene, model: Model, pack: Path, out: Path) -> dict[str, float]:
    """Return the held-out views' mean PSNR, dB, SSIM and AbsRel; keep the middle view's picture."""
    render, rules = model.render, replace(preset("paper"), truth="lidar")
    psnr, ssim, abs_rel = [], [], []
    for position in scene.test:
        view, image = render(scene.T_world_cam[position], scene.camera), np.asarray(scene.images[position])
        scored = ImageScore.over(view.rgb, image)
        psnr.append(-10 * np.log10(scored.mse))
        ssim.append(scored.ssim_uniform7)
        truth_m = codecs.read_depth_png(truth_path(pack, scene.ids[position]))
        row = score_frame(Comparison(scene.ids[position], view.depth_m, None, truth_m), rules)
        abs_rel.append(row.metrics()["abs_rel"])
        if position == scene.test[len(scene.test) // 2]:
            codecs.write_image(out / "view.png", _picture(image, view))
    means = {"psnr": np.mean(psnr), "ssim_uniform7": np.mean(ssim), "abs_rel": np.mean(abs_rel)}
    return {name: round(float(value), 4) for name, value in means.items()}


def _picture(image: np.ndarray, view: RenderedView) -> np.ndarray:
    """Put the true view, the rendered one and its inverse depth (white: 4 m and nearer) below each other, uint8."""
    rendered = np.rint(255 * np.clip(view.rgb, 0, 1)).astype(np.uint8)
    near = np.clip(255 * 4 / np.maximum(view.depth_m, 1e-3), 0, 255).astype(np.uint8)
    return np.concatenate([image, rendered, np.repeat(near[..., None], 3, axis=2)])
