"""What the processes of a cluster do: some plan drives, others hold methods and compute frames.

Nothing here knows Ray: planner and builder are called with plain values, and could be called by any engine.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from priors.build import Job
from priors.build.work import Work
from priors.cache import Prior
from priors.errors import DataError, told
from priors.machine import threads
from priors.scale import tries
from priors.scale.order import Order
from priors.scale.tally import Part
from priors.types import Method

OPEN_DRIVES = 4
"""Drives that a builder keeps open: stretches of one drive mostly follow each other."""


@dataclass(frozen=True)
class Stretch:
    """Some frames of a drive that one process computes, and all that was decided for the drive."""

    drive: int
    """Which of the orders."""
    method: Method
    """Every 'auto' is decided, so that all processes decide alike."""
    folder: Path
    """The prior's."""
    manifest: dict[str, Any]
    """The prior's."""
    distrust: bool
    """As in Job."""
    indices: list[int]
    """Of the frames in the drive."""


def plan_drive(number: int, order: Order, size: int) -> Iterator[Part | Stretch]:
    """Plan a drive: give what its plan says, then its frames in stretches of `size`.

    What is done once a drive is done here: 'auto's are decided, a network adapts, the prior's folder is made.
    """
    try:
        job = order.prepare()
        plan = job.plan(order.selection)
        job.restamp(plan)
        if plan.todo:
            job.expect_room(plan)
            tries.forget(job.prior.folder)
            with threads.limited(threads.count()):
                job.begin(lambda frame_id: None, lambda line: None)
        else:
            job.end()
    except (DataError, OSError) as error:
        yield Part(number, error=told(error))
        return
    yield Part.of_plan(number, job.prior, plan)
    decided = job.method, job.prior.folder, job.prior.manifest, job.distrust
    indices: list[int] = []
    for chain in job.chains.group(plan.todo):  # frames that are made of each other stay together
        indices += chain
        if len(indices) >= size:
            yield Stretch(number, *decided, indices)
            indices = []
    if indices:
        yield Stretch(number, *decided, indices)


class Builder:
    """Computes stretches of frames; its process loads each network once, and keeps the last drives open."""

    def __init__(self, orders: Sequence[Order], workers: int, cores: int) -> None:
        """Take the orders that stretches are of; compute `workers` frames at a time, with so many cores."""
        self.orders, self.workers, self.cores = orders, workers, cores
        self._open: OrderedDict[int, Work] = OrderedDict()

    def __call__(self, stretch: Stretch) -> Part:
        """Compute a stretch and write its maps; what is wrong with a frame, or the drive, is in what is returned."""
        with threads.limited(self.cores):
            try:
                work = self._work(stretch)
            except (DataError, OSError) as error:
                failed = {f"position {index}": str(error) for index in stretch.indices}
                return Part(stretch.drive, done=len(failed), failed=failed)
            ids = [work.chains.drive.ids[index] for index in stretch.indices]
            try:
                work.do(stretch.indices, self.workers, lambda line: None)
            except Exception as error:  # a full disk, a fault of ours: the drives' other frames must go on
                why = told(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
                work.failed.update({id_: why for id_ in ids if not work.prior.has(id_)})
        failed = {id_: work.failed[id_] for id_ in ids if id_ in work.failed}
        return Part.of_frames(stretch.drive, work.prior, [id_ for id_ in ids if id_ not in failed], failed)

    def _job(self, stretch: Stretch) -> Job:
        """Return the job that the drive's planner made."""
        order = self.orders[stretch.drive]
        if order.temporal:  # it is of two priors: that of the single maps is found again
            return replace(order, method=stretch.method).prepare()
        prior = Prior(stretch.folder, stretch.manifest)
        return Job(order.open(), stretch.method, order.filters, prior, stretch.distrust, order.reuse)

    def _work(self, stretch: Stretch) -> Work:
        """Return what computes frames of the stretch's drive, opening it where it is not open."""
        if stretch.drive not in self._open:
            work = self._job(stretch).work()
            work.maker = replace(work.maker, whole=tries.guarded(work.maker.whole, stretch.folder))
            self._open[stretch.drive] = work
        self._open.move_to_end(stretch.drive)
        while len(self._open) > OPEN_DRIVES:
            self._open.popitem(last=False)
        work = self._open[stretch.drive]
        work.built.clear()
        work.left.clear()
        work.failed.clear()
        return work
