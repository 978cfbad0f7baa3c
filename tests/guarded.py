"""A drive in memory that notes which frames are read and refuses those that are held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from priors.types import Frame

T = TypeVar("T")


@dataclass
class GuardedDrive:
    """Frames 000000, 000001, ...; those in `closed` must not be read. What they hold is a subclass's matter."""

    count: int = 12
    closed: Sequence[int] = ()
    name: str = "guarded"
    read: list[int] = field(default_factory=list)

    @property
    def ids(self) -> list[str]:
        return [f"{number:06d}" for number in range(self.count)]

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Frame:
        raise NotImplementedError

    def reader(self, index: int, make: Callable[[], T]) -> Callable[[], T]:
        """What a frame calls to get its image or its points."""

        def read() -> T:
            assert index not in self.closed, f"frame {index} is held out, and was read"
            self.read.append(index)
            return make()

        return read

    def describe(self) -> dict[str, Any]:
        return {"dataset": self.name, "path": "/nowhere"}

    def fingerprint(self) -> str:
        return f"{self.name} {self.count}"
