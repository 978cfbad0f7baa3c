"""The real scenes that completion learns from: KITTI 2015 with its own truth, and KITTI raw drives with sweeps.

| source    | truth                                                              | validated on              |
|-----------|--------------------------------------------------------------------|---------------------------|
| kitti2015 | the benchmark's disparity, cars as models of their kind, as depth  | what priors/held_back says |
| a drive   | accumulated sweeps                                                 | its first frames          |

A drive with held-back frames trains on all others.
"""

from pathlib import Path

from priors.drives import open_drive
from priors.drives.kitti_raw import KittiRaw
from priors.errors import DataError
from priors.held_back import HeldBack, is_held_back, training_frames
from priors.learn.accumulated_lidar import own_scene, scenes_of
from priors.learn.lidar_scene import BENCHMARK, LidarScene
from priors.types import Drive, Frame

STEREO_2015 = "kitti_stereo2015"
"""The folder below the user's."""
HELD_OUT = 4
"""First frames of a drive of which nothing is held back: for validation."""
SHARES = {BENCHMARK: 3.0}
"""How often a source is drawn from, where not once: the others have a single place each."""


class RealScenes:
    """Scenes by source, held in memory."""

    def __init__(self, folder: Path) -> None:
        """Take a drive's folder, or one whose kitti_raw_train/ holds drives, and kitti_stereo2015/ pairs with sweeps.

        Raises DataError where there is neither.
        """
        self.train: dict[str, list[LidarScene]] = {}
        self.validation: dict[str, list[LidarScene]] = {}
        self._read_benchmark(folder / STEREO_2015)
        drives = sorted((folder / "kitti_raw_train").glob("*/*_sync"))
        for path in drives or ([] if self.train else [folder]):
            self._read_drive(path)

    def shares(self) -> list[float]:
        """Return how often each source of `train` is drawn from; the sum is 1."""
        weights = [SHARES.get(source, 1.0) for source in self.train]
        return [weight / sum(weights) for weight in weights]

    def _read_benchmark(self, folder: Path) -> None:
        if not folder.is_dir():
            return
        drive = open_drive(folder)
        held_back = HeldBack(drive)
        self.train[BENCHMARK] = _with_truth(training_frames(drive))
        self.validation[BENCHMARK] = _with_truth([held_back[at] for at in range(len(held_back))])

    def _read_drive(self, path: Path) -> None:
        drive = KittiRaw(path)
        name, frames = drive.name, training_frames(drive)
        scenes = scenes_of(frames, name)
        held_out = 0 if _has_held_back(drive) else HELD_OUT
        self.train[name], self.validation[name] = scenes[held_out:], scenes[:held_out]
        if not self.validation[name]:
            del self.validation[name]
        if not self.train[name]:
            raise DataError(f"{path}: {len(scenes)} frames: completion needs more than {held_out} to learn from")


def _with_truth(frames: list[Frame]) -> list[LidarScene]:
    """Make scenes of the frames that have both a sweep and truth."""
    whole = [frame for frame in frames if frame.has("sweep") and frame.has("truth")]
    return [own_scene(frame, frame.truth().depth_m, BENCHMARK) for frame in whole]


def _has_held_back(drive: Drive) -> bool:
    return any(is_held_back(drive.name, id_) for id_ in drive.ids)
