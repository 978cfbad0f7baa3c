"""A drive whose LiDAR has fewer scan lines: how cost grows with them is measured on it."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from priors.drive_around import DriveAround
from priors.types import Drive, Frame, Sweep

LINES = 64
"""Lines that a scanner is taken to have, spread evenly between its lowest and its highest point."""


class FewerLines(DriveAround):
    """A drive whose sweeps keep every n-th line; true and sparse maps are left out."""

    def __init__(self, drive: Drive, every: int) -> None:
        super().__init__(drive)
        self.every = every

    def frame(self, index: int) -> Frame:
        """Return the frame at a position, with thinner sweeps."""
        frame = self.drive[index]
        if "sweep" not in frame.readers:
            return frame
        read = frame.readers["sweep"]

        def thinned(*args: Any) -> Sweep | None:
            sweep = read(*args)
            return None if sweep is None else thin(sweep, self.every)

        kept = {what: reader for what, reader in frame.readers.items() if what not in ("sparse", "truth")}
        return replace(frame, readers=kept | {"sweep": thinned})


def thin(sweep: Sweep, every: int) -> Sweep:
    """Return a sweep with every n-th of its lines, told apart by elevation."""
    kept = line_of(sweep.xyz_m) % every == 0
    return replace(sweep, xyz_m=sweep.xyz_m[kept], time_s=None if sweep.time_s is None else sweep.time_s[kept])


def line_of(xyz_m: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """Return each point's line (n,), 0 to LINES - 1 from the top, by its elevation above the scanner's plane."""
    if not len(xyz_m):
        return np.zeros(0, np.int64)
    elevation = np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1])).astype(np.float64)
    low, high = np.quantile(elevation, (0.002, 0.998))  # a stray point is no line
    share = np.clip((high - elevation) / max(high - low, 1e-6), 0, 1)
    return np.rint(share * (LINES - 1)).astype(np.int64)
