"""An order: one drive to build, with all that decides its maps; it travels to the process that builds it."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from priors import build, drives
from priors.build import Job
from priors.cache.store import is_store
from priors.filters import Filters
from priors.scale.drive_list import DriveEntry
from priors.selection import Selection
from priors.types import Drive, Method


@dataclass(frozen=True)
class Order:
    """A drive to build."""

    entry: DriveEntry
    """Which drive."""
    method: Method
    """How to make depth; 'auto's are decided on the drive's first frame."""
    filters: Filters = field(default_factory=Filters)
    """What to leave out of the maps."""
    cache: Path = Path("cache")
    """Where the maps go."""
    selection: Selection = field(default_factory=Selection)
    """Which frames."""
    reuse: int = 1
    """How many frames share one map that is made whole; see priors.build.prepare."""
    temporal: int = 0
    """With the maps of how many frames before and after it each map is joined."""

    @property
    def absolute(self) -> "Order":
        """The same, for a process that works in another folder."""
        cache = self.cache if is_store(self.cache) else self.cache.absolute()
        return replace(self, entry=self.entry.absolute, cache=cache)

    def open(self) -> Drive:
        """Open the drive; DataError where it cannot be."""
        return drives.open_drive(self.entry.path, self.entry.dataset, self.entry.part)

    def prepare(self) -> Job:
        """Decide every 'auto' and find the prior's place in the cache; DataError where that cannot be."""
        return build.prepare(self.open(), self.method, self.filters, self.cache, self.reuse, self.temporal)
