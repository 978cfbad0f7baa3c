"""Training loop: a model is fitted to a scene, whatever its family."""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from nerf import fields
from nerf.checkpoint import Spent, resume, save
from nerf.config import FitConfig
from nerf.model import Model
from nerf.scene import Scene
from priors.machine import threads

SAVE_EVERY_S = 30.0
LOG_EVERY = 20


@dataclass(frozen=True)
class Status:
    """Where a fit is."""

    step: int
    elapsed_s: float
    progress: float
    """Share of the budget, [0, 1]."""
    terms: dict[str, Tensor]
    """The last batch's losses; on a GPU, looking at them waits for the step to end."""
    loss: Tensor
    """Their weighted sum."""
    rays: int
    """Rays of the last batch."""
    samples: int
    """Samples of the last batch."""
    step_s: float
    """How long the last step took."""

    @property
    def psnr(self) -> float:
        """The last batch's PSNR, dB."""
        return -10 * math.log10(max(float(self.terms["rgb"]), 1e-10))

    def line(self) -> str:
        """Return a line of metrics.jsonl."""
        numbers: dict[str, float | Tensor] = {
            "seconds": self.elapsed_s,
            "psnr": self.psnr,
            "loss": self.loss,
            **self.terms,
        }
        rounded = {name: float(f"{float(value):.6g}") for name, value in numbers.items()}
        return json.dumps({"step": self.step, **rounded, "samples": self.samples}) + "\n"


OnStep = Callable[[Status], None]


@threads.quiet()
def fit(
    scene: Scene, config: FitConfig, run: Path, on_step: OnStep = lambda status: None, device: str = "cpu"
) -> Model:
    """Train until the budget is spent, or go on where the run's checkpoint left off; without parameters, only save.

    Checkpoints are written every SAVE_EVERY_S seconds, at the end, and when interrupted; metrics.jsonl gets a line
    every LOG_EVERY steps.

    Args:
        scene: what is learned.
        config: everything that decides the outcome.
        run: the run's folder.
        on_step: called after each step.
        device: cpu, or a GPU as torch names it.

    Raises:
        DataError: there is no such family, or the run's checkpoint is damaged or was made with other settings.
    """
    model = fields.family(config.model.family).start(scene, config, device)
    if not model.parameters():
        save(run, model, Spent(), scene.origin_m)
        return model
    done = resume(run, model)
    step, elapsed = done.step, done.elapsed_s
    saved = time.perf_counter()
    clock = saved - elapsed
    run.mkdir(parents=True, exist_ok=True)
    log = (run / "metrics.jsonl").open("a", buffering=1, encoding="utf-8")
    try:
        while (progress := config.progress(step, elapsed)) < 1:
            result = model.train(scene, config, step, progress)
            now = time.perf_counter()
            step, took, elapsed = step + 1, now - clock - elapsed, now - clock
            share = config.progress(step, elapsed)
            status = Status(step, elapsed, share, result.terms, result.total, result.rays, result.samples, took)
            if step % LOG_EVERY == 0:
                log.write(status.line())
            on_step(status)
            if now - saved > SAVE_EVERY_S:
                save(run, model, Spent(step, elapsed), scene.origin_m)
                saved = now
    finally:
        log.close()
        if step > done.step:
            save(run, model, Spent(step, elapsed), scene.origin_m)
    return model
