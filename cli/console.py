"""What every command shares: one-line errors, exit codes, tables and progress on a terminal or in a pipe."""

import errno
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from cli.compiling import CompilingColumn, Watch
from cli.logs import explain_error
from cli.terminal import err as err
from cli.terminal import out as out
from cli.terminal import silence
from priors.errors import DataError, UsageError

DATA_ERROR, USAGE_ERROR, INTERRUPTED = 1, 2, 130
SILENT_S = 2.0
"""Work that takes longer says what it does."""
TOLD_S = 10.0
"""From one line to the next in a pipe, of work whose length is not known."""
SHOWN_S = 0.5
"""On a terminal it says so from here on: words that flash up are not read."""

watch = Watch(err)
"""Tells when kernels are compiled."""
LABEL = TextColumn("{task.description}", markup=False)


def guarded(command: Callable[[], int]) -> int:
    """Run a command; known errors become one line and an exit code, unknown ones keep their traceback."""
    _refuse_foreign_eval()
    watch.install()
    try:
        return command()
    except DataError as error:
        explain_error()
        err.complain(error)
        return USAGE_ERROR if isinstance(error, UsageError) else DATA_ERROR
    except KeyboardInterrupt:
        err.print("interrupted: what was finished is kept; run the same command again to go on")
        return INTERRUPTED
    except BrokenPipeError:  # nobody reads on: `priors list | head`
        silence(sys.stdout)
        return 0
    except OSError as error:
        explain_error()
        err.complain(_told(error))
        return DATA_ERROR
    except MemoryError as error:
        explain_error()
        err.complain(f"not enough memory ({error or 'no more is given'}): close programs, or ask for less at a time")
        return DATA_ERROR
    finally:
        watch.finish()


def _told(error: OSError) -> str:
    """Say in a line which file the system refuses, and why."""
    names = [str(name) for name in (error.filename, error.filename2) if name is not None]
    cause = error.strerror or str(error) or type(error).__name__
    hint = ": free some space and run the same command again" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
    return f"{' -> '.join(names) or 'file system'}: {cause}{hint}"


@contextmanager
def _bar(*columns: ProgressColumn, transient: bool = False) -> Iterator[Progress]:
    """Show a progress bar, which goes in the end where it is transient; what is compiled stands in its last column."""
    watch.bar_begins()
    try:
        with Progress(*columns, CompilingColumn(watch), console=err, transient=transient) as bar:
            yield bar
    finally:
        watch.bar_ends()


def _refuse_foreign_eval() -> None:
    """Stop where a script named eval.py in the current folder hides our package."""
    import eval as ours

    if ours.__file__ and Path(ours.__file__).parent.parent != Path(__file__).parent.parent:
        err.complain(f"another module named eval is first on the path: {ours.__file__}: rename it")
        raise SystemExit(USAGE_ERROR)


@contextmanager
def progress(label: str, total: int) -> Iterator[Callable[..., None]]:
    """Show a progress bar on a terminal; in a pipe a line every tenth, of what takes longer than SILENT_S.

    Yields what to call once a step.
    """
    if err.moves:
        columns = (LABEL, BarColumn(), MofNCompleteColumn())
        with _bar(*columns, TimeElapsedColumn(), TimeRemainingColumn()) as bar:
            task = bar.add_task(label, total=total)
            yield lambda *_: bar.advance(task)
        return
    done, began = 0, time.perf_counter()

    def step(*_: object) -> None:
        nonlocal done
        done += 1
        if 10 * done // total > 10 * (done - 1) // total and time.perf_counter() - began > SILENT_S:
            err.print(f"{label} {done}/{total}")

    yield step


@contextmanager
def growing_progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar whose length becomes known as it goes; in a pipe a line at times, of what takes long.

    Yields what to call with the steps that were done, and those that came to be known.
    """
    done = total = 0
    if err.moves:
        with _bar(LABEL, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()) as bar:
            task = bar.add_task(label, total=None)

            def move(steps: int, more: int) -> None:
                nonlocal total
                total += more
                bar.update(task, advance=steps, total=total or None)

            yield move
        return
    told = time.perf_counter()

    def tell(steps: int, more: int) -> None:
        nonlocal done, total, told
        done, total = done + steps, total + more
        if steps and time.perf_counter() - told > TOLD_S:
            told = time.perf_counter()
            err.print(f"{label}: {done}/{total} frames")

    yield tell


@contextmanager
def busy(label: str) -> Iterator[None]:
    """Say what is being done where nothing can be counted, while it lasts; what is done soon is not told.

    On a terminal it stands there from SHOWN_S on, and goes; in a pipe two lines are told from SILENT_S on.
    """
    began, shown = time.perf_counter(), ExitStack()

    def show() -> None:
        if err.moves:
            bar = shown.enter_context(_bar(LABEL, TimeElapsedColumn(), transient=True))
            bar.add_task(label, total=None)
        else:
            err.print(f"{label} ...")
            shown.callback(lambda: err.print(f"{label}: {time.perf_counter() - began:.0f} s"))

    timer = threading.Timer(SHOWN_S if err.moves else SILENT_S, show)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        shown.close()


@contextmanager
def train_progress(label: str) -> Iterator[Callable[..., None]]:
    """Show loss, error and time left of a network's training on a terminal, a line every tenth in a pipe."""
    from priors.learn.loop import TrainProgress

    def line(status: TrainProgress) -> str:
        return f"step {status.step}, " + ", ".join(f"{k} {v:.3g}" for k, v in status.values.items())

    if err.moves:
        columns = (LABEL, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        with _bar(*columns, TextColumn("{task.fields[line]}", markup=False)) as bar:
            task = bar.add_task(label, total=1.0, line="")
            yield lambda status: bar.update(task, completed=status.done, line=line(status))
        return
    tenths = _Tenths()

    def step(status: TrainProgress) -> None:
        if tenths.passed(status.done):
            err.print(f"{label} {status.done:.0%}: {line(status)}")

    yield step


@contextmanager
def fit_progress(label: str) -> Iterator[Callable[..., None]]:
    """Show loss, PSNR, rays a second and time left on a terminal, a line every tenth in a pipe."""
    from nerf.fit import Status

    told = 0.0

    def line(status: Status) -> str:
        speed = status.rays / max(status.step_s, 1e-6)
        return f"PSNR {status.psnr:.1f} dB, loss {status.loss:.4f}, {speed / 1e3:.1f} k rays/s, step {status.step}"

    if err.moves:
        columns = (LABEL, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        with _bar(*columns, TextColumn("{task.fields[line]}", markup=False)) as bar:
            task = bar.add_task(label, total=1.0, line="")

            def draw(status: Status) -> None:
                nonlocal told
                if status.elapsed_s - told >= 0.2 or status.progress >= 1:  # a line's numbers wait for a GPU
                    told = status.elapsed_s
                    bar.update(task, completed=status.progress, line=line(status))

            yield draw
        return

    tenths = _Tenths()

    def step(status: Status) -> None:
        if tenths.passed(status.progress):
            err.print(f"{label} {status.progress:.0%}: {line(status)}")

    yield step


class _Tenths:
    """Tells when another tenth of some work is done; what was done before, when it goes on, is not told again."""

    def __init__(self) -> None:
        self._told: int | None = None

    def passed(self, done: float) -> bool:
        """Return whether a tenth was passed since the last call; `done` is in [0, 1]."""
        now = int(10 * done + 1e-9)
        before, self._told = self._told, now
        return now > before if before is not None else now >= 10
