"""A drive around another one: a subclass changes what differs, all else is the drive's own."""

from collections.abc import Sequence
from typing import Any

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

    def __getitem__(self, index: int) -> Frame:
        return self.drive[index]
