"""Lap: the stretch of a fit from one mark to the next, and what it takes. Compiling and scoring lie between laps."""

import time
from contextlib import suppress

from nerf.bench.marks import Mark
from nerf.fit import OnStep, Status
from nerf.run import Run


class ReachedError(Exception):
    """The lap's mark is reached: the fit keeps its checkpoint and ends."""


class Lap:
    """Called after each step of a fit, as nerf.fit asks: measures, and stops it at a mark."""

    def __init__(self, mark: Mark, is_first: bool, watch: OnStep) -> None:
        """Begin to measure; the first lap of a fit counts its preparation too."""
        self._mark, self._is_first, self._watch = mark, is_first, watch
        self._began_s, self._processor_s = time.perf_counter(), time.process_time()
        self.prepared_s = 0.0
        """What came before the first step, where that counts: the model's making, carving."""
        self.processor_s = 0.0
        """Processor time of all threads."""
        self.status: Status | None = None
        """After the last step."""

    def __call__(self, status: Status) -> None:
        """Measure a step; raises where the mark is reached."""
        if self.status is None:
            if self._is_first:
                self.prepared_s = time.perf_counter() - self._began_s - status.step_s
            else:
                self._processor_s = time.process_time()  # without this step, which is one of hundreds
        self.status = status
        self.processor_s = time.process_time() - self._processor_s
        self._watch(status)
        if self._mark.reached(status):
            raise ReachedError


def go(run: Run, device: str, lap: Lap) -> None:
    """Train a run until the lap's mark."""
    with suppress(ReachedError):
        run.fit(device, lap)
