"""Keeper: writes a fit's checkpoints, soon after it began and then at times; only good ones, only in its own folder."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nerf.checkpoint import Spent, save
from nerf.finite import NotFiniteError, bad_tensor
from nerf.model import Model
from nerf.world import here
from priors.errors import DataError
from priors.origin import Offset

LOG = logging.getLogger(__name__)
FIRST_S = 4.0
"""From the end of the first step, which may compile kernels, to the first checkpoint: it is there within 5 s."""
EVERY_S = 30.0
"""From one checkpoint to the next."""


class LostError(DataError):
    """A fit whose folder another process has taken over."""


@dataclass
class Keeper:
    """Keeps one fit's model; `kept` is what its checkpoint has spent."""

    run: Path
    model: Model
    origin_m: Offset
    kept: Spent
    lost: Callable[[], bool] = lambda: False
    """Whether another process has taken the folder over."""
    due_s: float | None = None
    """When the next checkpoint is due, by time.perf_counter; None before the first step."""

    def keep_if_due(self, spent: Spent) -> None:
        """Write a checkpoint where it is time."""
        now_s = time.perf_counter()
        if self.due_s is None:
            self.due_s = now_s + FIRST_S
        elif now_s >= self.due_s:
            self.keep(spent)

    def keep(self, spent: Spent) -> None:
        """Write a checkpoint, unless there is nothing new.

        Raises:
            NotFiniteError: the model is no good any more; the checkpoint before is left.
            LostError: the folder is another process's now; its files are left alone.
        """
        if spent.step == self.kept.step:
            return
        if not here().leads:
            self.kept = spent
            return
        if self.lost():
            raise LostError(f"{self.run}: another process took this run over while this one stood still: it goes on")
        bad = bad_tensor(self.model.state())
        if bad is not None:
            raise NotFiniteError(f"{bad} is not finite after step {spent.step}")
        save(self.run, self.model, spent, self.origin_m)
        LOG.info("%s: checkpoint of step %d after %.1f s", self.run, spent.step, spent.elapsed_s)
        self.kept = spent
        self.due_s = time.perf_counter() + EVERY_S
