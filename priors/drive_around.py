"""A drive around another one: a subclass changes what differs, all else is the drive's own.

The nearest example is a stretch of a drive: `drive[10:20]`.
"""

from collections.abc import Sequence
from typing import Any, overload

from priors.errors import DataError
from priors.selection import range_of
from priors.types import Drive, Frame


class DriveAround:
    """Passes on what a drive says."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive

    @property
    def name(self) -> str:
        """Folder name in the cache."""
        return self.drive.name

    @property
    def ids(self) -> Sequence[str]:
        """Frame ids in time order."""
        return self.drive.ids

    def describe(self) -> dict[str, Any]:
        """Return what reopens the drive."""
        return self.drive.describe()

    def fingerprint(self) -> str:
        """Return a digest of calibration, poses and the first image."""
        return self.drive.fingerprint()

    def __len__(self) -> int:
        return len(self.drive)

    def __repr__(self) -> str:
        return tell(self)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> "Stretch": ...

    def __getitem__(self, index: int | slice) -> "Frame | Stretch":
        return self.stretch(index) if isinstance(index, slice) else self.frame(index)

    def frame(self, index: int) -> Frame:
        """Return the frame at a position."""
        return self.drive[index]

    def stretch(self, part: slice) -> "Stretch":
        """Return the frames that Python's slice takes."""
        return Stretch(self, range(len(self))[part])


class Stretch(DriveAround):
    """Some frames of a drive, in its order. Its maps go to the drive's folder of the cache: it is the same drive."""

    def __init__(self, drive: Drive, positions: range) -> None:
        """Take the frames at these positions."""
        super().__init__(drive)
        self._positions = positions

    @property
    def frames(self) -> str:
        """The range a:b of the whole drive's frame numbers; DataError where frames between are left out."""
        places = self._positions
        if not places or places.step != 1:
            raise DataError(f"{self.name}: {places} is no range of neighbouring frames: slice it as drive[a:b]")
        return range_of(self.drive.ids, places.start, places.stop)

    @property
    def ids(self) -> Sequence[str]:
        """Frame ids in the order of the slice."""
        return [self.drive.ids[position] for position in self._positions]

    def __len__(self) -> int:
        return len(self._positions)

    def frame(self, index: int) -> Frame:
        """Return the frame at a position of the stretch."""
        return self.drive[self._positions[index]]

    def stretch(self, part: slice) -> "Stretch":
        """Return frames of the stretch: a stretch of the same drive."""
        return Stretch(self.drive, self._positions[part])


def tell(drive: Drive) -> str:
    """Return a drive's repr: its name and frames."""
    ids = drive.ids
    which = f"{len(ids)} frames, {ids[0]} to {ids[-1]}" if len(ids) > 1 else "one frame" if ids else "no frame"
    return f"{type(drive).__name__}({drive.name}, {which})"
