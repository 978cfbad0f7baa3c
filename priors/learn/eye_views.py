"""Real pairs from both cameras: a mirrored pair makes the right image a left one, so that both can be learned."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from priors.drives.kitti_odometry import KittiOdometry
from priors.geometry import mirror_columns
from priors.types import Image

Side = Literal["left", "right"]
RIGHT = "_right"
"""Ends the names of the right eye's views."""


@dataclass(frozen=True, slots=True)
class EyeView:
    """One eye's view of a pair; a right eye's is mirrored."""

    sequence: str
    frame_id: str
    side: Side
    left: Image
    right: Image

    @property
    def name(self) -> str:
        """Return what files about this view are called."""
        return f"{self.sequence}_{self.frame_id}" + (RIGHT if self.side == "right" else "")


def sequences(data: Path) -> list[Path]:
    """List the sequences of a KITTI odometry folder."""
    return sorted(path.parent for path in (data / "kitti_odometry" / "sequences").glob("*/calib.txt"))


def read_views(sequence: Path, camera: str = "image_0") -> Iterator[EyeView]:
    """Read the pairs of a sequence, each as either eye sees it."""
    drive = KittiOdometry(sequence, camera)
    for index in range(len(drive)):
        frame = drive[index]
        left, right = frame.image(), frame.other()
        yield EyeView(sequence.name, frame.id, "left", left, right)
        yield EyeView(sequence.name, frame.id, "right", mirror_columns(right), mirror_columns(left))
