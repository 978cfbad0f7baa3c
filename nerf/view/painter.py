"""Painter: one thread that draws the pictures of all browsers; a field can render one thing at a time."""

import threading
import time
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from nerf.types import Render
from nerf.view.picture import Picture
from nerf.view.turns import Turns
from priors.types import Camera, Matrix

Deliver: TypeAlias = Callable[[int, Picture], None]
"""Shows a browser its picture; called on the painter's thread."""
OFTEN_S = 0.2
"""How often the bands of a level are shown, at most."""
FOLLOWED = 0.3
"""Weight of the newest piece in the mean of the speed."""


class Painter:
    """Draws what browsers ask for, coarse to fine; a browser's newer camera gives its older picture up."""

    def __init__(self, render: Render, deliver: Deliver) -> None:
        self.fault: BaseException | None = None
        """What ended the thread, if anything did."""
        self.rays_a_second = 20_000.0
        """Measured as it draws."""
        self._render, self._deliver = render, deliver
        self._turns, self._shown_s = Turns(), dict[int, float]()
        self._changed = threading.Condition()
        self._going = True
        self._thread = threading.Thread(target=self._serve, name="roadprior-painter", daemon=True)

    def warm(self, T_world_cam: Matrix, camera: Camera) -> None:
        """Render a view twice before anyone looks: kernels are compiled, and the speed is known."""
        for _ in range(2):
            began = time.perf_counter()
            self._render(T_world_cam, camera)
            self.rays_a_second = camera.size[0] * camera.size[1] / (time.perf_counter() - began)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the piece in hand: a process that ends in the midst of one says so on stderr."""
        with self._changed:
            self._going = False
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def ask(self, client: int, T_world_cam: Matrix, camera: Camera) -> None:
        """Draw a view for a browser, instead of what it asked for before."""
        with self._changed:
            self._turns.begin(client, Picture(T_world_cam, camera, self.rays_a_second))
            self._changed.notify_all()

    def leave(self, client: int) -> None:
        """Draw nothing more for a browser."""
        with self._changed:
            self._turns.leave(client)
            self._shown_s.pop(client, None)

    def picture(self, client: int) -> Picture | None:
        """Return a browser's newest picture."""
        with self._changed:
            return self._turns.picture(client)

    def _serve(self) -> None:
        try:
            while True:
                with self._changed:
                    found = None
                    while self._going and (found := self._turns.next()) is None:
                        self._changed.wait()
                    if not self._going or found is None:
                        return
                self._draw(*found)
        except BaseException as fault:  # told by the main thread, which waits: priors/view/server.py
            self.fault = fault

    def _draw(self, client: int, picture: Picture) -> None:
        """Draw a picture's next piece. What a newer camera has overtaken is shown only if it is a first level.

        While a camera moves, every picture is overtaken; without its first level nothing would be seen.
        """
        piece, began = picture.take(), time.perf_counter()
        view = self._render(picture.T_world_cam, piece.camera)
        now = time.perf_counter()
        self._follow(piece.camera.size[0] * piece.camera.size[1] / max(now - began, 1e-6))
        picture.paste(piece, view)
        newest = self.picture(client)
        due = piece.last or now - self._shown_s.get(client, -np.inf) >= OFTEN_S
        if newest is not None and ((newest is picture and due) or piece.first):
            self._shown_s[client] = now
            self._deliver(client, picture)

    def _follow(self, rays_a_second: float) -> None:
        self.rays_a_second += FOLLOWED * (rays_a_second - self.rays_a_second)
