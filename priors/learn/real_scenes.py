"""The real scenes that completion learns from: KITTI 2015 with its own truth, and KITTI raw drives with sweeps.

| source    | truth                                                              | validated on               |
|-----------|--------------------------------------------------------------------|----------------------------|
| kitti2015 | the benchmark's disparity, cars as models of their kind, as depth  | what priors/held_back says |
| a drive   | accumulated sweeps                                                 | some of its first frames   |

A drive with held-back frames trains on all others, and is validated on some of those.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from priors.adapt.training_frames import pick_evenly
from priors.drives.kitti_raw import KittiRaw
from priors.errors import DataError
from priors.held_back import held_back, training_frames
from priors.learn.accumulated_lidar import own_scene, scenes_of
from priors.learn.crop_pack import CropPack
from priors.learn.lidar_scene import LidarScene
from priors.learn.moment import STREET, Moment
from priors.learn.real_truth import KITTI2015, RealTruth
from priors.types import Frame

HELD_OUT = 4
"""First frames of a drive of which nothing is held back: for validation."""
VALIDATED = 8
"""Held-back frames of a drive that are validated on: one for each density."""
SHARES = {KITTI2015: 3.0}
"""How often a source is drawn from, where not once: the others have a single place each."""


@dataclass(frozen=True)
class RealScenes:
    """Scenes by source, held in memory."""

    train: dict[str, list[LidarScene]] = field(default_factory=dict)
    validation: dict[str, list[LidarScene]] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Take a drive's folder, or one whose kitti_raw_train/ holds drives, and kitti_stereo2015/ pairs with sweeps.

        Raises DataError where there is neither.
        """
        self = cls()
        pairs = RealTruth(folder)
        if scenes := _with_truth(pairs.frames.get(KITTI2015, [])):
            self.train[KITTI2015], self.validation[KITTI2015] = scenes, _with_truth(pairs.held_back)
        drives = sorted((folder / "kitti_raw_train").glob("*/*_sync"))
        for path in drives or ([] if self.train else [folder]):
            self._read_drive(path)
        return self

    @classmethod
    def packed(cls, pack: CropPack) -> Self:
        """Take the real crops with a sweep of a pack."""
        parts = pack.train, pack.held_back
        return cls(*({name: made for name, all_ in part.items() if (made := _scenes(name, all_))} for part in parts))

    def shares(self) -> list[float]:
        """Return how often each source of `train` is drawn from; the sum is 1."""
        weights = [SHARES.get(source, 1.0) for source in self.train]
        return [weight / sum(weights) for weight in weights]

    def _read_drive(self, path: Path) -> None:
        drive = KittiRaw(path)
        name, frames = drive.name, training_frames(drive)
        if len(frames) <= HELD_OUT:
            raise DataError(f"{path}: {len(frames)} frames to learn from: completion needs more than {HELD_OUT}")
        scenes = scenes_of(frames, name)
        if len(frames) == len(drive):
            self.train[name], self.validation[name] = scenes[HELD_OUT:], scenes[:HELD_OUT]
        else:
            some = pick_evenly(held_back(drive), VALIDATED)
            self.train[name], self.validation[name] = scenes, scenes_of([drive[at] for at in some], name)


def _scenes(source: str, moments: list[Moment]) -> list[LidarScene]:
    return [] if source == STREET else [moment.scene() for moment in moments if moment.scan is not None]


def _with_truth(frames: list[Frame]) -> list[LidarScene]:
    """Make scenes of the frames that have both a sweep and truth."""
    whole = [frame for frame in frames if frame.has("sweep") and frame.has("truth")]
    return [own_scene(frame, frame.truth().depth_m, KITTI2015) for frame in whole]
