"""The Ray engine: drives are planned and stretches of their frames computed by Ray Data, on as many nodes as there are.

    drives -> plan (tasks) -> stretches of frames -> build (actors that hold methods) -> parts of the tally

Ray Data starts the processes, feeds them, and gives what a dead one had in hand to another. What is computed lies in
the cache by then and is not computed twice (priors/build/work.py); what kills its process again and again is reported
(tries.py). Only numbers and lines of text travel.
"""

import logging
import pickle
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

from priors.scale.crew import Builder, Stretch, plan_drive
from priors.scale.here import OnPart
from priors.scale.order import Order
from priors.scale.ray_session import Share, session, slots
from priors.scale.tally import Part

PLANNERS = 4
"""Drives that are planned at the same time."""
STRETCH = 8
"""Frames that a process is given at once: few, so that all end together and little is in hand when one dies."""
Row = dict[str, Any]


def build_on_ray(
    orders: Sequence[Order], workers: int, on_part: OnPart, share: Share | None = None, address: str | None = None
) -> None:
    """Build drives on a Ray cluster; whatever is wrong with a drive or a frame is told, and the others go on.

    Args:
        orders: the drives; their paths must mean the same on all nodes.
        workers: frames that each process computes at the same time.
        on_part: told the plan of each drive, and what came of its frames, stretch by stretch.
        share: what each process gets of a node.
        address: of the cluster; None: one is started on this machine.

    Raises:
        DataError: Ray is not installed, there is no cluster at the address, or no node is large enough.
    """
    share = share or Share()
    orders = [order.absolute for order in orders]
    with session(address) as ray:
        for part in _parts(ray, orders, (workers, share)):
            on_part(part)


def _parts(ray: ModuleType, orders: Sequence[Order], crew: tuple[int, Share]) -> Iterator[Part]:
    """Give what becomes of the drives, as soon as it is known."""
    from ray import data

    workers, share = crew
    logging.getLogger("ray.data").setLevel(logging.ERROR)  # its import has set another level
    context = data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    numbers = data.from_items(list(range(len(orders))), override_num_blocks=len(orders))
    planned = numbers.flat_map(
        _Planner(orders), num_cpus=0, compute=data.TaskPoolStrategy(size=min(PLANNERS, len(orders)))
    )
    built = planned.repartition(target_num_rows_per_block=1).map(
        _RayBuilder,
        fn_constructor_args=(orders, workers, share.cpus),
        compute=data.ActorPoolStrategy(min_size=1, max_size=slots(ray, share), max_tasks_in_flight_per_actor=2),
        **share.options,
    )
    for row in built.iter_rows():
        yield Part.unpack(row["part"])


class _Planner:
    """Plans the drive of a row: gives rows of parts and of stretches."""

    def __init__(self, orders: Sequence[Order]) -> None:
        self.orders = orders

    def __call__(self, row: Row) -> Iterator[Row]:
        number = int(row["item"])
        for found in plan_drive(number, self.orders[number], STRETCH):
            if isinstance(found, Part):
                yield {"part": found.pack(), "stretch": b""}
            else:
                yield {"part": "", "stretch": pickle.dumps(found)}


class _RayBuilder:
    """A builder as Ray's actor: what was planned passes through."""

    def __init__(self, orders: Sequence[Order], workers: int, cores: int) -> None:
        self.builder = Builder(orders, workers, cores)

    def __call__(self, row: Row) -> Row:
        if not row["stretch"]:
            return {"part": row["part"]}
        stretch: Stretch = pickle.loads(row["stretch"])
        return {"part": self.builder(stretch).pack()}
