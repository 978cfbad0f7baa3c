"""Tasks on a Ray cluster: one function, many items, results as they come; a wrong one does not end the rest."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Generic, TypeVar

from eval.errors import DataError
from priors.machine import threads
from priors.scale.ray_session import Share, slots

AHEAD = 2
"""Tasks that are given out for each process there is room for: one runs, one waits."""
RETRIES = 2
"""A task whose process or node died is tried so often again."""
WAIT_S = 2.0
Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Done(Generic[Made]):
    """What came of an item."""

    number: int
    """Its place in the list."""
    made: Made | None
    error: str = ""
    """Why nothing did."""


def run_tasks(
    ray: ModuleType,
    function: Callable[[Item], Made],
    items: Sequence[Item],
    share: Share,
    on_wait: Callable[[], None] = lambda: None,
) -> Iterator[Done[Made]]:
    """Call a function with each item, in processes of the cluster; give what comes of each as soon as it is there.

    Args:
        ray: a connected one, of `session`.
        function: of a module that all nodes have; its DataErrors are told.
        items: what it is called with; they travel.
        share: what each call gets of a node.
        on_wait: called every WAIT_S while tasks run, to look how far they are.

    Raises:
        DataError: no node is large enough.
    """
    task = ray.remote(_called).options(**share.options, max_retries=RETRIES)
    most = AHEAD * slots(ray, share)
    pending: dict[Any, int] = {}
    waiting = iter(enumerate(items))
    while True:
        while len(pending) < most and (following := next(waiting, None)) is not None:
            number, item = following
            pending[task.remote(function, item, share.cpus)] = number
        if not pending:
            return
        done, _ = ray.wait(list(pending), num_returns=1, timeout=WAIT_S)
        if not done:
            on_wait()
        for ready in done:
            yield _result(ray, ready, pending.pop(ready))


def _called(function: Callable[[Item], Made], item: Item, cores: int) -> tuple[Made | None, str]:
    """Call a function in a process of the cluster; returns what it makes, or why it cannot."""
    try:
        with threads.limited(cores):
            return function(item), ""
    except DataError as error:
        return None, str(error)


def _result(ray: ModuleType, ready: Any, number: int) -> Done[Any]:
    try:
        made, error = ray.get(ready)
    except ray.exceptions.RayTaskError:
        raise  # a fault of ours: its traceback is of use
    except ray.exceptions.RayError as lost:
        return Done(number, None, f"{RETRIES + 1} processes died with it ({type(lost).__name__})")
    return Done(number, made, error)
