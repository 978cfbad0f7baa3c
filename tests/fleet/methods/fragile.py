"""A method for tests of clusters: flat depth after a nap; on some frames it kills its process, or fails."""

import os
import signal
import time
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from priors.types import Depth, Frame, Input, Method


@dataclass(frozen=True)
class Fragile(Method):
    """Depth that says which frame it is of."""

    VERSION: ClassVar[int] = 1
    nap_s: float = 0.0
    """How long a frame takes, seconds."""
    deadly: str = ""
    """Id of a frame that kills the process, as a fault in a library does."""
    broken: str = ""
    """Id of a frame whose computing raises what is no DataError."""

    @property
    def reads(self) -> tuple[Input, ...]:
        return ()

    def resolve(self, frame: Frame) -> Self:
        return self

    def __call__(self, frame: Frame) -> Depth:
        time.sleep(self.nap_s)
        if frame.id == self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        if frame.id == self.broken:
            raise ZeroDivisionError("by what the image shows")
        number = sum(map(ord, frame.id)) % 200 + 1
        return Depth(np.full(frame.camera.size, number, np.float32))
