"""A drive for tests of clusters: as many frames as counted.txt says, without any files."""

from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import DriveOptions
from priors.types import Camera, Frame

SIZE = (4, 6)
NAME = "counted.txt"


def recognises(path: Path) -> bool:
    return (path / NAME).is_file()


def open_drive(path: Path, options: DriveOptions) -> "Counted":
    return Counted(path)


class Counted:
    """A priors.types.Drive."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ids = [f"{number:06d}" for number in range(int((folder / NAME).read_text("utf-8")))]

    @property
    def name(self) -> str:
        return self.folder.name

    def describe(self) -> dict[str, Any]:
        return {"dataset": "counted", "path": str(self.folder.absolute()), "camera": "front", "truth": None}

    def fingerprint(self) -> str:
        return f"counted {len(self.ids)}"

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        return Frame(self.ids[index], Camera(np.eye(3), SIZE), {})


def write_counted(folder: Path, frames: int) -> Path:
    folder.mkdir(parents=True)
    (folder / NAME).write_text(str(frames), "utf-8")
    return folder
