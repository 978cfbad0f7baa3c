"""Training loop: a model is fitted to a scene, whatever its family."""

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

from torch import Tensor

from nerf import fields, journal
from nerf.blocks import Blocks, part
from nerf.checkpoint import Spent, begin, open_model, resume, save
from nerf.config import FitConfig
from nerf.finite import NotFiniteError, bad_terms, cause
from nerf.keeper import Keeper, LostError
from nerf.model import Model, StepResult
from nerf.scene import Scene
from nerf.world import here
from priors.errors import expect
from priors.machine import threads

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
    scene: Scene,
    config: FitConfig,
    run: Path,
    on_step: OnStep = lambda status: None,
    device: str = "cpu",
    lost: Callable[[], bool] = lambda: False,
) -> Model:
    """Train until the budget is spent, or go on where the run's checkpoint left off; without parameters, only save.

    Checkpoints are written soon after the beginning, then every half minute (nerf/keeper.py), at the end, and when
    interrupted; metrics.jsonl gets a line every LOG_EVERY steps.

    Args:
        scene: what is learned.
        config: everything that decides the outcome.
        run: the run's folder.
        on_step: called after each step.
        device: cpu, or a GPU as torch names it.
        lost: tells whether another process has taken the folder over.

    Where several processes fit together (nerf/world.py), the first one writes, and its clock counts.

    Raises:
        DataError: there is no such family, or the run's checkpoint is damaged or was made with other settings; the
            loss is not finite any more; or the run is another process's now.
    """
    _expect_shared(config)
    if config.blocks_m is not None:
        return _fit_blocks(scene, config, run, on_step, (device, lost))
    return _fit_one(scene, config, run, on_step, (device, lost))


def _fit_blocks(
    scene: Scene, config: FitConfig, run: Path, on_step: OnStep, how: tuple[str, Callable[[], bool]]
) -> Model:
    """Fit a field for each block of the path, one after the other; each has the whole budget."""
    cut = cut_blocks(scene, config, run)
    for number in range(len(cut)):

        def tell(status: Status, number: int = number) -> None:
            on_step(replace(status, progress=(number + status.progress) / len(cut)))

        _fit_one(cut.scene(scene, number), config, part(run, number), tell, how)
    here().wait()
    return open_model(run, how[0])


def cut_blocks(scene: Scene, config: FitConfig, run: Path) -> Blocks:
    """Cut a scene into the blocks that are asked for, and write that into the run's folder.

    Raises:
        UsageError: the family has no blocks, or a block has too few training views.
        DataError: the run was cut otherwise.
    """
    family, length_m = config.model.family, config.blocks_m or 0.0
    expect(fields.shares(family), "--blocks", f"{length_m:g}", f"a hash family, --field {family} has no blocks")
    cut = Blocks.cut(scene, length_m)
    if here().leads:
        cut.save(run)
    return cut


def _fit_one(scene: Scene, config: FitConfig, run: Path, on_step: OnStep, how: tuple[str, Callable[[], bool]]) -> Model:
    """Train one field, or go on; `how`: the device, and what tells whether the folder is another's now."""
    device, lost = how
    model = begin(run, scene, config, device)
    if not model.parameters():
        save(run, model, Spent(), scene.origin_m)
        return model
    done = resume(run, model)
    run.mkdir(parents=True, exist_ok=True)
    here().wait()  # each has read the checkpoint before the first writes the next
    keeper = Keeper(run, model, scene.origin_m, done, lost)
    with _journal(run, done.step) as log:
        try:
            _train(scene, config, keeper, log, on_step)
        except NotFiniteError as error:
            raise NotFiniteError(f"{scene.name}: {error}: {cause(scene, config)}; {_left(keeper)}") from error
    return model


def _expect_shared(config: FitConfig) -> None:
    """Raise UsageError where several processes are to fit what only one can."""
    if here().size == 1:
        return
    family, least = config.model.family, config.model.sampler.roulette_rays
    expect(fields.shares(family), "--field", family, "one that several processes can fit together, or start one")
    expect(least == 1, "--roulette-rays", least, "1 where several processes fit together")


def _journal(run: Path, step: int) -> TextIO:
    """Open the journal where the first process writes it on; the others write nowhere."""
    if not here().leads:
        return Path(os.devnull).open("w", encoding="utf-8")
    journal.cut(run, step)
    return (run / journal.NAME).open("a", buffering=1, encoding="utf-8")


def _train(scene: Scene, config: FitConfig, keeper: Keeper, log: TextIO, on_step: OnStep) -> None:
    """Take the steps that are left; where one fails or is interrupted, those before it are kept."""
    spent, clock = keeper.kept, time.perf_counter() - keeper.kept.elapsed_s
    try:
        while (progress := here().leaders(config.progress(spent.step, spent.elapsed_s))) < 1:
            result = keeper.model.train(scene, config, spent.step, progress)
            before, spent = spent, Spent(spent.step + 1, time.perf_counter() - clock)
            _look(result, spent.step)
            status = _status(config, before, spent, result)
            if spent.step % LOG_EVERY == 0:
                log.write(status.line())
            on_step(status)
            keeper.keep_if_due(spent)
    except (NotFiniteError, LostError):
        raise  # what was kept last is the last good one
    except BaseException:
        keeper.keep(spent)
        raise
    keeper.keep(spent)


def _look(result: StepResult, step: int) -> None:
    """Stop where a loss is no number. Looking waits for a GPU, so there it is done only where a line is written."""
    if result.total.device.type == "cpu" or step % LOG_EVERY == 0:
        bad = bad_terms(result)
        if bad:
            told = ", ".join(f"{name} {value:g}" for name, value in bad.items())
            raise NotFiniteError(f"the loss is not finite at step {step} ({told})")


def _status(config: FitConfig, before: Spent, spent: Spent, result: StepResult) -> Status:
    share = config.progress(spent.step, spent.elapsed_s)
    took_s = spent.elapsed_s - before.elapsed_s
    return Status(spent.step, spent.elapsed_s, share, result.terms, result.total, result.rays, result.samples, took_s)


def _left(keeper: Keeper) -> str:
    """Say what there is to go on from."""
    if keeper.kept.step == 0:
        return "nothing was kept"
    return f"the checkpoint of step {keeper.kept.step} is kept"
