"""Works on the newest request only: a dragged slider asks faster than points can be made."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Wish = TypeVar("Wish")


class Newest(Generic[Wish]):
    """A thread that works on wishes, the newest first; one that a newer has overtaken is never begun."""

    def __init__(self, work: Callable[[Wish], None]) -> None:
        self.fault: BaseException | None = None
        """What ended the thread, if anything did."""
        self._work = work
        self._wishes: list[Wish] = []
        self._changed = threading.Condition()
        self._busy = False
        self._going = True
        self._thread = threading.Thread(target=self._serve, name="roadprior-view", daemon=True)
        self._thread.start()

    def ask(self, wish: Wish) -> None:
        """Let a wish be worked on next."""
        with self._changed:
            self._wishes = [wish]
            self._changed.notify_all()

    def stop(self) -> None:
        """End the thread after the work in hand."""
        with self._changed:
            self._going = False
            self._changed.notify_all()
        self._thread.join()

    def settle(self, timeout_s: float = 60.0) -> bool:
        """Wait until nothing is left to do; returns whether that is so in time."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._wishes and not self._busy, timeout_s)

    def _serve(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: bool(self._wishes) or not self._going)
                    if not self._going:
                        return
                    wish, self._busy = self._wishes.pop(), True
                self._work(wish)
                self._rest()
        except BaseException as fault:  # told by the main thread, which waits: `server.wait`
            self.fault = fault
            self._rest()

    def _rest(self) -> None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
