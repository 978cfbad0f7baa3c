"""What the commands say while kernels are compiled: that they are, how many, how long, and that it is done."""

import threading
import time
from pathlib import Path

from rich.progress import ProgressColumn, Task
from rich.status import Status
from rich.table import Column as TableColumn
from rich.text import Text

from cli.terminal import Screen
from priors.machine import notices

QUIET_S = 2.0
"""A burst of compiling is over when nothing was compiled for so long."""
WORTH_S = 1.0
"""Bursts after the first are told of from this long on."""


class Watch:
    """Counts what is compiled and tells it on a console; a bar that runs there shows `column`."""

    def __init__(self, console: Screen) -> None:
        self._console, self._lock = console, threading.RLock()
        self._nested = self._functions = self._bars = self._bursts = 0
        self._seconds = self._since = 0.0
        self._told = False
        self._status: Status | None = None
        self._timer: threading.Timer | None = None

    def install(self) -> None:
        """Ask to be told from now on."""
        if self._begin not in notices.on_compile:
            notices.on_compile.append(self._begin)
            notices.on_compiled.append(self._end)

    def finish(self) -> None:
        """Tell what is still to be told; at the end of a command."""
        with self._lock:
            self._stop_status()
            self._close_burst()

    def bar_begins(self) -> None:
        """Leave the terminal to a progress bar: two things cannot move on it."""
        with self._lock:
            self._bars += 1
            self._stop_status()

    def bar_ends(self) -> None:
        """Take the terminal back."""
        with self._lock:
            self._bars -= 1

    def text(self) -> str:
        """Say how far it is, or nothing where nothing is being compiled."""
        if not self._nested:
            return ""
        seconds = self._seconds + time.perf_counter() - self._since
        return f"compiling kernels: {self._functions} done, {seconds:.0f} s"

    def __rich__(self) -> str:
        return self.text()

    def _begin(self, name: str) -> None:
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._nested += 1
            if self._nested > 1:
                return
            self._since = time.perf_counter()
            if not self._told:
                self._told = True
                self._console.print(f"compiling kernels for this CPU, once ({_kept()})")
            if self._console.moves and not self._bars:
                self._status = self._status or Status(self, console=self._console, spinner="line")
                self._status.start()

    def _end(self, name: str) -> None:
        with self._lock:
            self._functions += 1
            self._nested -= 1
            if self._nested:
                return
            self._seconds += time.perf_counter() - self._since
            self._stop_status()
            self._timer = threading.Timer(QUIET_S, self._close_burst)
            self._timer.daemon = True
            self._timer.start()

    def _close_burst(self) -> None:
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            if self._nested or not self._functions:
                return
            if not self._bursts or self._seconds >= WORTH_S:
                plural = "" if self._functions == 1 else "s"
                self._console.print(f"compiled {self._functions} function{plural} in {self._seconds:.0f} s")
            self._bursts += 1
            self._functions, self._seconds = 0, 0.0

    def _stop_status(self) -> None:
        if self._status is not None:
            self._status.stop()


class CompilingColumn(ProgressColumn):
    """A bar's column that shows what a watch has to say."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(table_column=TableColumn(no_wrap=True))
        self._watch = watch

    def render(self, task: Task) -> Text:
        """Return the text, for the first task of a bar only."""
        return Text(self._watch.text() if task.id == 0 else "")


def _kept() -> str:
    """Say where compiled kernels are kept."""
    from priors.machine.compiled import kept_in

    folder = kept_in()
    if folder is None:
        return "and again next time: no folder to keep them in can be written: set ROADPRIOR_CACHE"
    try:
        return f"kept in ~/{folder.relative_to(Path.home())}"
    except (ValueError, RuntimeError):
        return f"kept in {folder}"
