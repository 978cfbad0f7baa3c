"""Fit a model to a scene: one loop."""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from torch import Tensor

from nerf import fields
from nerf.checkpoint import Progress, resume, save
from nerf.losses import LossConfig
from nerf.model import Model, ModelConfig
from nerf.occupancy import Occupancy
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.scene import Scene
from nerf.space import Space
from priors.machine import threads

SAVE_EVERY_S = 30.0
OCCUPANCY_EVERY = 16
LOG_EVERY = 20


@dataclass(frozen=True)
class FitConfig:
    """Everything that decides a run's outcome; config.json holds it."""

    model: ModelConfig = field(default_factory=ModelConfig)
    losses: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    rays: int = 1024
    """Rays in a step."""
    steps: int | None = None
    """Stop after so many steps: the same seed gives the same bits on a CPU, however often the run was resumed."""
    seconds: float | None = 60.0
    """Or stop after this time; how far it gets depends on the machine."""
    seed: int = 0
    """Decides weights, rays and sample positions."""


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


def start(scene: Scene, config: FitConfig, device: str = "cpu") -> Model:
    """Make an untrained model around a scene, carved where the scene has a prior."""
    points_m = scene.points_m()
    positions_m = scene.T_world_cam[scene.train, :3, 3]
    space = Space.around(positions_m, points_m, fields.family(config.model.family).space)
    sampler = config.model.sampler
    carve = sampler.carve and scene.depth_m is not None
    trust = sampler.trust
    occupancy = Occupancy.carve(space, scene, trust=trust, device=device) if carve else Occupancy(space, device=device)
    return Model(config.model, space, occupancy, config.seed, device)


@threads.quiet()
def fit(
    scene: Scene, config: FitConfig, run: Path, on_step: OnStep = lambda status: None, device: str = "cpu"
) -> Model:
    """Train until the budget is spent, or go on where the run's checkpoint left off.

    Checkpoints are written every SAVE_EVERY_S seconds, at the end, and when interrupted; metrics.jsonl gets a line
    every LOG_EVERY steps.
    """
    model = start(scene, config, device)
    optimiser = Optimiser(config.optimiser, model.parameters(), model.copies())
    done = resume(run, model, optimiser)
    rules = replace(config.losses, distortion=config.losses.distortion * model.family.distortion)
    step, elapsed = done.step, done.elapsed_s
    saved = time.perf_counter()
    clock = saved - elapsed
    run.mkdir(parents=True, exist_ok=True)
    log = (run / "metrics.jsonl").open("a", buffering=1)
    try:
        while _progress(config, step, elapsed) < 1:
            progress = _progress(config, step, elapsed)
            rays = scene.draw(config.rays, config.seed, step).to(model.device)
            found = model.train(rays, rules, (config.seed, step), progress)
            optimiser.step(progress)
            if step % OCCUPANCY_EVERY == 0:
                model.occupancy.update(model.density, (config.seed, step))
            now = time.perf_counter()
            step, took, elapsed = step + 1, now - clock - elapsed, now - clock
            share = _progress(config, step, elapsed)
            status = Status(step, elapsed, share, found.terms, found.total, config.rays, found.samples, took)
            if step % LOG_EVERY == 0:
                log.write(status.line())
            on_step(status)
            if now - saved > SAVE_EVERY_S:
                save(run, model, optimiser, Progress(step, elapsed))
                saved = now
    finally:
        log.close()
        if step > done.step:
            save(run, model, optimiser, Progress(step, elapsed))
    return model


def _progress(config: FitConfig, step: int, elapsed_s: float) -> float:
    """Return the spent share of the budget: of the steps where they are given, else of the time."""
    if config.steps is not None:
        return min(1.0, step / max(config.steps, 1))
    return min(1.0, elapsed_s / config.seconds) if config.seconds else 1.0
