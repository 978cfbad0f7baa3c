"""Threads that sleep while they wait: our kernels run as tasks of one pool, and the libraries' own threads are held.

A kernel is compiled for one thread, lets go of Python's lock and does one task of a call. Tasks are taken one after
the other by whoever is free: a thread that another process keeps from its core takes fewer, and nobody spins. (OpenMP
divides the work beforehand, so that all wait for the slowest; its threads and OpenBLAS's burn the cores as they do.)
"""

import itertools
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from queue import SimpleQueue
from typing import TYPE_CHECKING

from priors.errors import DataError

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Work = Callable[[int], object]
"""What a thread does for the task of a number."""

TASK_NS = 200_000
"""What a task should take at least."""

OPENMP = "OMP_NUM_THREADS"

_asked: int | None = None
_pool: list["SimpleQueue[_Job]"] = []
_growing, _changing = threading.Lock(), threading.Lock()
_holders, _hold = 0, None  # of the matrix libraries' threads


def available() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


MOST_THREADS = 1024
"""More are a slip of the keys: no machine that this is for has so many cores."""


def usual() -> int:
    """Return how many threads a command uses that is not told: OMP_NUM_THREADS, else every core it may use."""
    told = os.environ.get(OPENMP, "")
    return min(int(told), MOST_THREADS) if told.isdecimal() and int(told) else available()


def count() -> int:
    """Return how many threads a call uses: what `limited` says, else what PyTorch is set to, else the usual number."""
    if _asked is not None:
        return _asked
    return int(sys.modules["torch"].get_num_threads()) if "torch" in sys.modules else usual()


@contextmanager
def limited(threads: int | None) -> Iterator[None]:
    """Let every call inside use so many threads, ours and the libraries'; None: as many as outside.

    OpenBLAS gets one: its threads spin for a tenth of a second after each product, and our products are small. PyTorch,
    where it is not there yet, is told by a variable that it reads when it loads. Serves as a decorator too.
    Raises DataError for less than one.
    """
    global _asked
    if threads is not None and threads < 1:
        raise DataError(f"expected 1 thread or more, found {threads}")
    before = _asked
    calm()
    with _one_blas_thread(), ExitStack() as undo:
        if threads is not None:
            undo.callback(_limit_opencv(threads))
            undo.callback(_limit_torch(threads))
            _asked = threads
        try:
            yield
        finally:
            _asked = before


def _limit_opencv(threads: int) -> Callable[[], None]:
    """Set OpenCV's threads; returns what sets them back."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    return lambda: cv2.setNumThreads(before)


def _limit_torch(threads: int) -> Callable[[], None]:
    """Set PyTorch's threads, now or when it loads; returns what sets them back."""
    torch, told, before = sys.modules.get("torch"), os.environ.get(OPENMP), usual()
    if torch is not None:
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
    os.environ[OPENMP] = str(threads)

    def undo() -> None:
        if told is None:
            os.environ.pop(OPENMP, None)
        else:
            os.environ[OPENMP] = told
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(before)

    return undo


@contextmanager
def quiet() -> Iterator[None]:
    """Let the libraries work on the calling thread alone inside, and our pool on as many as outside.

    For work of our kernels and many small operations between them: PyTorch's threads would spin after each of those
    and keep the pool's from the cores. Serves as a decorator too: `@threads.quiet()`.
    """
    with limited(count()):
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)
        yield


def calm() -> None:
    """Let PyTorch's threads sleep soon after their work, once it is loaded; costs a parked thread, once a process."""
    if "torch" in sys.modules:
        _park()


@cache
def _park() -> None:
    """Keep an idle team of OpenMP threads.

    GNU's OpenMP spins for milliseconds after each of its regions, on the cores that our threads then need, unless it
    has more threads than there are cores ("GOMP_SPINCOUNT" in libgomp's manual). OMP_WAIT_POLICY would do it too, but
    it is read when PyTorch loads, and a program may import that before us.
    """
    ready = threading.Event()

    def park() -> None:
        torch = sys.modules["torch"]
        before = torch.get_num_threads()
        try:
            torch.set_num_threads(max(2, before))  # a program may have set 1 before: that would be no team
            torch.zeros(1 << 17).exp_()  # large enough for a team
        finally:
            torch.set_num_threads(before)
            ready.set()
        threading.Event().wait()

    threading.Thread(target=park, name="roadprior-parked", daemon=True).start()
    ready.wait()


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Hold the matrix libraries to one thread until the last of all threads that ask for it is done."""
    global _holders, _hold
    with _changing:
        _holders += 1
        if _holders == 1:
            _hold = _blas().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _changing:
            _holders -= 1
            if not _holders:
                _hold.restore_original_limits()


@cache
def _blas() -> "ThreadpoolController":
    """Return the handle of the matrix libraries that are loaded by now; looking for them takes milliseconds."""
    import numpy  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def run(tasks: int, work: Work) -> None:
    """Call work(0) ... work(tasks - 1), each once, on the calling thread and the pool's; raises what a task raised.

    What comes out must not depend on which thread does which task, nor on their order.
    """
    helpers = min(count(), tasks) - 1
    if helpers < 1:
        for task in range(tasks):
            work(task)
        return
    calm()
    job = _Job(tasks, work)
    for queue in _helpers(helpers):
        queue.put(job)
    job.help()
    job.wait()


def stretches(total: int, block: int = 1, each: int = 4) -> list[tuple[int, int]]:
    """Cut [0, total) into about `each` stretches a thread, (first, last) each, whose ends are multiples of `block`."""
    blocks = -(-total // block)
    parts = max(1, min(blocks, each * count() if count() > 1 else 1))
    ends = [blocks * part // parts * block for part in range(parts)] + [total]
    return [(first, last) for first, last in itertools.pairwise(ends) if last > first]


def worth(item_ns: float) -> int:
    """Return how many items of about so many nanoseconds are worth a task: handing one over takes 20 microseconds."""
    return max(1, int(TASK_NS // max(item_ns, 1)))


def over(total: int, work: Callable[[int, int], object], block: int = 1, each: int = 4) -> None:
    """Call work(first, last) for stretches that cover [0, total)."""
    parts = stretches(total, block, each)
    run(len(parts), lambda task: work(*parts[task]))


class _Job:
    """The tasks of one call, and who is still at one."""

    def __init__(self, tasks: int, work: Work) -> None:
        self._tasks, self._work = tasks, work
        self._tickets, self._ends = itertools.count(), itertools.count(1)  # next() of these is one step for all threads
        self._over = threading.Lock()
        self._over.acquire()
        self._fault: BaseException | None = None

    def help(self) -> None:
        """Do tasks until none is left to take."""
        while (task := next(self._tickets)) < self._tasks:
            try:
                if self._fault is None:
                    self._work(task)
            except BaseException as fault:  # the caller raises it again
                self._fault = fault
            if next(self._ends) == self._tasks:
                self._over.release()

    def wait(self) -> None:
        """Sleep until the last task is done; then the caller alone holds what the tasks held.

        A helper may wake only afterwards. If it freed the tasks' tensors as the process ends, the process would abort:
        PyTorch's destructor waits for the interpreter, which ends such a thread in the midst of it.
        """
        self._over.acquire()
        fault, self._fault = self._fault, None
        del self._work
        if fault is not None:
            raise fault


def _helpers(wanted: int) -> list["SimpleQueue[_Job]"]:
    """Return the queues of so many helping threads; starts those that are not there yet."""
    if len(_pool) < wanted:
        with _growing:
            while len(_pool) < wanted:
                queue: SimpleQueue[_Job] = SimpleQueue()
                threading.Thread(target=_serve, args=(queue,), name=f"roadprior-{len(_pool) + 1}", daemon=True).start()
                _pool.append(queue)
    return _pool[:wanted]


def _serve(queue: "SimpleQueue[_Job]") -> None:
    while True:
        queue.get().help()


def _forget() -> None:
    """Threads do not live on in a forked process: it starts its own."""
    global _growing, _changing
    _pool.clear()
    _park.cache_clear()
    _growing, _changing = threading.Lock(), threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
