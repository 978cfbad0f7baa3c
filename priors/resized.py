"""A drive whose images are smaller: how cost grows with an image's size is measured on it, and large images learn."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from priors.drive_around import DriveAround
from priors.geometry import resize
from priors.types import Depth, Drive, FloatMap, Frame


class Resized(DriveAround):
    """A drive whose images are smaller; true maps and sky masks are left out."""

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
    if "sparse" in frame.readers:
        readers["sparse"] = lambda: Depth(thinned(frame.sparse().depth_m, (height, width)))
    return replace(frame, camera=resize(frame.camera, (height, width)), readers=readers)


def thinned(sparse_m: FloatMap, size: tuple[int, int]) -> FloatMap:
    """Bring a sparse map to a smaller (height, width): of the values that fall on one pixel the nearest stays."""
    row, column = np.nonzero(sparse_m > 0)
    places = [
        ((at + 0.5) * new / old).astype(np.intp)
        for at, new, old in zip((row, column), size, sparse_m.shape, strict=True)
    ]
    small_m = np.full(size, np.inf, np.float32)
    np.minimum.at(small_m, tuple(places), sparse_m[row, column])
    return np.where(np.isfinite(small_m), small_m, np.float32(0))
