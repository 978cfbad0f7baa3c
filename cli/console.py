"""What every command shares: one-line errors, exit codes, tables and progress on a terminal or in a pipe."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.markup import escape
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
from priors.errors import DataError, UsageError

PIPE_WIDTH = 160
DATA_ERROR, USAGE_ERROR, INTERRUPTED = 1, 2, 130

out = Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)
err = Console(stderr=True, highlight=False, emoji=False, soft_wrap=True)
watch = Watch(err)
"""Tells when kernels are compiled."""


def guarded(command: Callable[[], int]) -> int:
    """Run a command; known errors become one line and an exit code, unknown ones keep their traceback."""
    _refuse_foreign_eval()
    watch.install()
    try:
        return command()
    except DataError as error:
        err.print(f"[bold red]error:[/] {escape(str(error))}")
        return USAGE_ERROR if isinstance(error, UsageError) else DATA_ERROR
    except KeyboardInterrupt:
        err.print("interrupted: what was finished is kept; run the same command again to go on")
        return INTERRUPTED
    except BrokenPipeError:
        return 0
    except OSError as error:
        err.print(f"[bold red]error:[/] {escape(str(error.filename or 'file system'))}: {error.strerror}")
        return DATA_ERROR
    finally:
        watch.finish()


@contextmanager
def _bar(*columns: ProgressColumn) -> Iterator[Progress]:
    """Show a progress bar; while it moves, what is compiled stands in its last column."""
    watch.bar_begins()
    try:
        with Progress(*columns, CompilingColumn(watch), console=err) as bar:
            yield bar
    finally:
        watch.bar_ends()


def _refuse_foreign_eval() -> None:
    """Stop where a script named eval.py in the current folder hides our package."""
    import eval as ours

    if ours.__file__ and Path(ours.__file__).parent.parent != Path(__file__).parent.parent:
        err.print(f"[bold red]error:[/] another module named eval is first on the path: {ours.__file__}: rename it")
        raise SystemExit(USAGE_ERROR)


@contextmanager
def progress(label: str, total: int) -> Iterator[Callable[..., None]]:
    """Show a progress bar on a terminal, a line every tenth in a pipe; yields what to call once a step."""
    if err.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with _bar(*columns, TimeElapsedColumn(), TimeRemainingColumn()) as bar:
            task = bar.add_task(label, total=total)
            yield lambda *_: bar.advance(task)
        return
    done = 0

    def step(*_: object) -> None:
        nonlocal done
        done += 1
        if done == total or done % max(1, total // 10) == 0:
            err.print(f"{label} {done}/{total}")

    yield step


@contextmanager
def train_progress(label: str) -> Iterator[Callable[..., None]]:
    """Show loss, error and time left of a network's training on a terminal, a line every 100 steps in a pipe."""
    from priors.learn.loop import TrainProgress

    def line(status: TrainProgress) -> str:
        return f"step {status.step}, " + ", ".join(f"{k} {v:.3g}" for k, v in status.values.items())

    if err.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        with _bar(*columns, TextColumn("{task.fields[line]}")) as bar:
            task = bar.add_task(label, total=1.0, line="")
            yield lambda status: bar.update(task, completed=status.done, line=line(status))
        return
    yield lambda status: err.print(f"{label}: {line(status)}") if status.step % 100 == 0 else None


@contextmanager
def fit_progress(label: str) -> Iterator[Callable[..., None]]:
    """Show loss, PSNR, rays a second and time left on a terminal, a line every 10 s in a pipe."""
    from nerf.fit import Status

    told = 0.0

    def line(status: Status) -> str:
        speed = status.rays / max(status.step_s, 1e-6)
        return f"PSNR {status.psnr:.1f} dB, loss {status.loss:.4f}, {speed / 1e3:.1f} k rays/s, step {status.step}"

    if err.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        with _bar(*columns, TextColumn("{task.fields[line]}")) as bar:
            task = bar.add_task(label, total=1.0, line="")

            def draw(status: Status) -> None:
                nonlocal told
                if status.elapsed_s - told >= 0.2 or status.progress >= 1:  # a line's numbers wait for a GPU
                    told = status.elapsed_s
                    bar.update(task, completed=status.progress, line=line(status))

            yield draw
        return

    def step(status: Status) -> None:
        nonlocal told
        if status.elapsed_s - told >= 10 or status.progress >= 1:
            told = status.elapsed_s
            err.print(f"{label} {status.progress:.0%}: {line(status)}")

    yield step
