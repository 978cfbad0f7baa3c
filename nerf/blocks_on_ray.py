"""Blocks on a Ray cluster: each block of a long drive is a task with its own cores or GPU.

A block is fitted as `nerf.fit` fits it on one machine, from the scene's files and into its own folder of the run, so it
is the same bits for the same number of steps. A task that is given again, because its process or node died, goes on
from the block's checkpoint.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import torch

from nerf import checkpoint, fields, journal
from nerf.asked import RunConfig
from nerf.blocks import load, part
from nerf.fit import OnStep, Status, cut_blocks, fit
from nerf.guide import TRUTH
from nerf.run import OWNER, Run
from priors.errors import DataError
from priors.machine.device import pick_device
from priors.owner import claim
from priors.owner.claim import Claim
from priors.scale.ray_session import Share
from priors.scale.tasks import run_tasks

Line: TypeAlias = dict[str, Any]
"""Of a journal."""
POLL_S = 1.0
"""How often to look whether the process that had a block before is dead by now."""


@dataclass(frozen=True)
class BlockTask:
    """One block of a run, for another process; folders mean the same on all nodes."""

    folder: Path
    """The run's."""
    config: RunConfig
    number: int
    """Which block."""
    device: str


@dataclass(frozen=True)
class RayBlocks:
    """Fits the blocks of a run on a cluster; what `Run.fit` takes in place of fitting them here."""

    ray: ModuleType
    share: Share

    def __call__(self, run: Run, device: str, on_step: OnStep) -> None:
        """Fit all blocks, or go on; returns when each is done.

        Raises:
            DataError: a block cannot be fitted; the others are done by then.
        """
        cut = cut_blocks(run.scene, run.config.fit, run.folder)
        folder, config = run.folder.absolute(), _absolute(run.config)
        numbers = [number for number in range(len(cut)) if not is_done(folder, config, number)]
        tasks = [BlockTask(folder, config, number, device) for number in numbers]
        watch, lost = Watch(run, len(cut), on_step), dict[int, str]()
        for done in run_tasks(self.ray, fit_task, tasks, self.share, watch) if tasks else ():
            if done.error:
                lost[numbers[done.number]] = done.error
            watch()
        if lost:
            number, why = next(iter(sorted(lost.items())))
            told = f"{len(lost)} of {len(cut)} blocks are not fitted, the first is block {number}: {why}"
            raise DataError(f"{run.folder}: {told}: the same command goes on with them")


def fit_task(task: BlockTask) -> None:
    """Fit one block in this process, or go on where it was left."""
    scene, home = Run(task.folder, task.config).scene, part(task.folder, task.number)
    block = load(task.folder).scene(scene, task.number)
    with _in_hand(home) as held:
        fit(
            block,
            replace(task.config.fit, blocks_m=None),
            home,
            device=pick_device(task.device),
            lost=lambda: held.lost,
        )


def is_done(folder: Path, config: RunConfig, number: int) -> bool:
    """Tell whether a block's checkpoint has spent the budget."""
    home = part(folder, number)
    if not (home / checkpoint.NAME).exists():
        return False
    spent = checkpoint.spent(home)
    return config.fit.progress(spent.step, spent.elapsed_s) >= 1


@dataclass(frozen=True)
class Watch:
    """Looks how far the blocks are, by the journals that their processes write on the shared folder."""

    run: Run
    count: int
    """Of blocks."""
    on_step: OnStep
    began_s: float = field(default_factory=time.perf_counter)

    def __call__(self) -> None:
        """Tell the share of all blocks' budgets, and where the block is that has the longest way to go."""
        homes = [part(self.run.folder, number) for number in range(self.count)]
        begun = [lines for home in homes if (lines := journal.read(home))]
        if begun:
            share = sum(self._progress(lines[-1]) for lines in begun) / self.count
            self._tell(min(begun, key=lambda lines: self._progress(lines[-1])), share)

    def _progress(self, line: Line) -> float:
        return self.run.config.fit.progress(line["step"], line["seconds"])

    def _tell(self, lines: Sequence[Line], share: float) -> None:
        """Tell of a block's lines as its own process would."""
        last, before = lines[-1], lines[-2] if len(lines) > 1 else {"step": 0, "seconds": 0.0}
        step_s = (last["seconds"] - before["seconds"]) / max(last["step"] - before["step"], 1)
        fit = self.run.config.fit
        growth = 1.0 if self.run.config.prior is None else fields.rays_growth(fit.model.family)
        rays = fit.rays_at(self._progress(last), growth)
        elapsed_s = time.perf_counter() - self.began_s
        terms, loss = {"rgb": torch.tensor(last["rgb"])}, torch.tensor(last["loss"])
        self.on_step(Status(last["step"], elapsed_s, share, terms, loss, rays, last["samples"], step_s))


@contextmanager
def _in_hand(home: Path) -> Iterator[Claim]:
    """Have a block in hand while the block of code runs, once the process that had it before is dead.

    A process on another node is known to be dead a minute after its last sign of life.
    """
    while (held := claim.take(home / OWNER)) is None:
        time.sleep(POLL_S)
    with held:
        yield held


def _absolute(config: RunConfig) -> RunConfig:
    """Return the config for a process that works in another folder."""
    known = config.prior is None or config.prior == TRUTH.name
    return config if known else replace(config, prior=str(Path(str(config.prior)).absolute()))
