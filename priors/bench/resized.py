"""A drive whose images are smaller: how cost grows with an image's size is measured on it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from priors.drive_around import DriveAround
from priors.geometry import resize
from priors.types import Drive, Frame


class Resized(DriveAround):
    """A drive whose images are smaller; true and sparse maps and sky masks are left out."""

    def __init__(self, drive: Drive, share: float) -> None:
        super().__init__(drive)
        self.share = share

    def frame(self, index: int) -> Frame:
        """Return the frame at a position, smaller."""
        return resized(self.drive[index], self.share)


def resized(frame: Frame, share: float) -> Frame:
    """Return a frame whose images have this share of their sides, 0 to 1."""
    height, width = (max(1, round(side * share)) for side in frame.camera.size)

    def shrunk(read: Callable[[], Any]) -> Any:
        return np.asarray(cv2.resize(read(), (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    readers = {what: frame.readers[what] for what in ("sweep",) if what in frame.readers}
    readers |= {what: partial(shrunk, frame.readers[what]) for what in ("image", "other") if what in frame.readers}
    return replace(frame, camera=resize(frame.camera, (height, width)), readers=readers)
