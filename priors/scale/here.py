"""The local engine: many drives on this machine, one after the other, frames in threads."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from priors.errors import DataError, told
from priors.scale.order import Order
from priors.scale.tally import Part

OnPart = Callable[[Part], None]
OnNote = Callable[[str], None]


def build_here(orders: Sequence[Order], workers: int, on_part: OnPart, on_note: OnNote = lambda line: None) -> None:
    """Build drives one after the other; one that cannot be built is told, and the others go on.

    Args:
        orders: the drives.
        workers: frames computed at the same time.
        on_part: told the plan of each drive, each frame as it is done, and what came of them.
        on_note: told what a method does before a drive's first frame.
    """
    for number, order in enumerate(orders):
        try:
            _build(number, order, workers, on_part, on_note)
        except (DataError, OSError) as error:  # OSError: a full disk or store
            on_part(Part(number, error=told(error)))


def _build(number: int, order: Order, workers: int, on_part: OnPart, on_note: OnNote) -> None:
    job = order.prepare()
    plan = job.plan(order.selection)
    on_part(Part.of_plan(number, job.prior, plan))
    try:
        report = job.run(plan, workers, lambda frame_id: on_part(Part(number, done=1)), on_note)
    except OSError as error:  # a full disk: what was built before counts
        built = [id_ for id_ in (job.drive.ids[index] for index in plan.todo) if job.prior.has(id_)]
        on_part(replace(Part.of_frames(number, job.prior, built, {}), done=0, error=told(error)))
        return
    on_part(Part.of_report(number, report))
