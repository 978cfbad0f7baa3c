"""The training loop that every network shares.

OUT/last.safetensors    weights, their running average, the optimiser's moments; written every minute and when stopped
   /last.json           step, seconds spent, config
   /best.safetensors    the running average that validated best: what `priors train pack` takes
   /log.jsonl           a line every few steps, and one a validation
   /pictures/*.png      what the network sees now

A stopped run goes on where it was: the batches follow from the seed and the step alone.
"""

import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from priors.adapt.training_step import Batch
from priors.learn.config import TrainConfig
from priors.learn.training_run import Task, TrainingRun
from priors.machine import threads

AHEAD = 3
"""Batches made in advance by the background threads, and another one for each thread after the first."""


@dataclass(frozen=True)
class TrainProgress:
    """What a step tells whoever watches."""

    step: int
    done: float
    """Share of the run, in [0, 1]."""
    values: dict[str, float]


def train(
    task: Task,
    out: Path,
    config: TrainConfig,
    about: dict[str, str | None] | None = None,
    device: str = "cpu",
    on_step: Callable[[TrainProgress], None] = lambda progress: None,
) -> dict[str, float]:
    """Train until the time or the steps are used up, or Ctrl-C; returns the last validation.

    Args:
        task: what is learned.
        out: the run's folder.
        config: how.
        about: what last.json says of the network: its name and size, and the weights that it started from.
        device: where.
        on_step: called every 20 steps.

    Raises DataError where the folder holds a run of another network, or the loss stops being finite.
    """
    with threads.limited(config.threads), Interrupt() as interrupt:
        run = TrainingRun(task, out, config, about or {}, device)
        run.resume()
        if run.step == 0 and run.about.get("start"):
            run.validate()  # so that nothing worse than the start is ever the best
        _take_steps(run, on_step, interrupt)
        if not interrupt.asked:
            run.validate()
        run.save()
    return run.validation


def _take_steps(run: TrainingRun, on_step: Callable[[TrainProgress], None], interrupt: "Interrupt") -> None:
    """Train until the run is done or interrupted; batches are made ahead in the background."""
    workers = run.config.workers
    with ThreadPoolExecutor(max_workers=workers) as pool:
        ahead: dict[int, Future[Batch]] = {}
        while run.progress() < 1 and not interrupt.asked:
            for step in range(run.step, run.step + AHEAD + workers - 1):
                if step not in ahead:
                    ahead[step] = pool.submit(run.task.batch, step, np.random.default_rng([run.config.seed, step]))
            values = run.advance(ahead.pop(run.step).result())
            if values:
                on_step(TrainProgress(run.step, run.progress(), values))
            if run.step % run.config.validate_every == 0:
                run.validate()
            if time.monotonic() - run.saved > run.config.save_s:
                run.save()
        for future in ahead.values():
            future.cancel()


class Interrupt:
    """Turns Ctrl-C and a polite kill into a wish to stop after the step in hand."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interrupt":
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                self._before[number] = signal.signal(number, self._ask)
            except ValueError:  # not the main thread: whoever runs us there handles signals
                break
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
