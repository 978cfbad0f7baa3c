"""The real views that mono learns from: single images of which some depth is known.

| source        | depth                                                        | validated on               |
|---------------|--------------------------------------------------------------|----------------------------|
| kitti2015     | the benchmark's disparity, cars as models of their kind      | what priors/held_back says |
| drive0009     | accumulated sweeps                                           |                            |
| sfnd          | one sweep                                                    | its last frames            |
| 06, 01 (grey) | KITTI odometry: the classical matcher's where it is sure     | their last frames          |
"""

from collections.abc import Iterator
from pathlib import Path

from priors import build, drives
from priors.adapt.views import UNKNOWN, LabelledView, label_sky
from priors.drives import DriveOptions
from priors.learn.real_truth import KITTI2015, RealTruth, truth_m
from priors.methods._reference import trusted
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import FloatMap, Frame

SLOW = "sfnd"
SHARES = {KITTI2015: 3.0}
"""How often a source is drawn from, where not once: the others have a single place each."""
HELD_OUT = {SLOW: 4, "06": 6, "01": 6}
"""Last frames of a drive of which nothing is held back: for validation."""
OFFSETS_PX = {"06": (0.0, 0.0, 1.4), "01": (0.0, 0.0, 2.4)}
"""What the rectification of KITTI odometry's pairs is off, against depth from ego-motion (docs/methods/stereo.md)."""


class RealViews:
    """Views by source, held in memory."""

    def __init__(self, folder: Path, cache: Path) -> None:
        """Read what there is below a folder; stereo's depth is computed once and kept in the cache."""
        true = RealTruth(folder)
        self.validation = [_view(frame, truth_m(frame), KITTI2015) for frame in true.held_back]
        self.train = {
            source: [_view(frame, truth_m(frame), source) for frame in frames] for source, frames in true.frames.items()
        }
        for view in (*_slow(folder), *_odometry(folder, cache)):
            self.train.setdefault(view.source, []).append(view)
        for source, count in HELD_OUT.items():
            if source in self.train:
                self.validation += self.train[source][-count:]
                del self.train[source][-count:]
        self.train = {source: views for source, views in self.train.items() if views}


def _view(frame: Frame, depth_m: FloatMap, source: str) -> LabelledView:
    image = frame.image()
    return LabelledView(image, frame.camera, depth_m, label_sky(image, depth_m), source)


def _slow(folder: Path) -> Iterator[LabelledView]:
    """Read the slow colour drive, which has no poses."""
    path = folder / "kitti_raw_train" / "2011_09_26" / "2011_09_26_drive_sfnd_sync"
    drive = drives.open_drive(path) if path.is_dir() else ()
    for index in range(len(drive)):
        yield _view(drive[index], Lidar(sweeps=1)(drive[index]).depth_m, SLOW)


def _odometry(folder: Path, cache: Path) -> Iterator[LabelledView]:
    """Read the grey odometry runs."""
    for sequence, offset_px in OFFSETS_PX.items() if (folder / "kitti_odometry").is_dir() else ():
        drive = drives.open_drive(folder / "kitti_odometry", options=DriveOptions(drive=sequence))
        prior = build.prepare(drive, Stereo(offset_px=offset_px), folder=cache).run().prior
        for index, id_ in enumerate(drive.ids):
            frame = drive[index]
            image, depth = frame.image(), prior.read(id_)
            depth_m = trusted(depth, image)
            sky = label_sky(image, depth_m)
            sky[(trusted(depth) > 0) & (depth_m == 0)] = UNKNOWN  # matched sky, or a bright wall taken for sky
            yield LabelledView(image, frame.camera, depth_m, sky, sequence)
