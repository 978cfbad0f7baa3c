"""What moments are made of: frames of real drives with truth, sweeps or a match, and rendered samples.

| source    | truth                                     | what else                  | held back                       |
|-----------|-------------------------------------------|----------------------------|---------------------------------|
| kitti2015 | official disparity                        | the raw sweep              | what priors/held_back.py says   |
| drive0009 | accumulated sweeps                        | several sweeps, a match    | the same                        |
| sfnd      | accumulated sweeps; one eye               | several sweeps             | its first frames                |
| odometry  | none: a match                             |                            | every tenth frame               |
| street    | everything, exact                         | a sweep                    | every tenth world               |
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from priors.adapt.training_frames import pick_evenly
from priors.drives.kitti_odometry import KittiOdometry
from priors.drives.kitti_raw import KittiRaw
from priors.geometry import convert_disparity
from priors.held_back import held_back
from priors.learn import lidar_scene, pair_file, pseudo_labels
from priors.learn.accumulated_lidar import INPUTS, own_scene, scenes_of
from priors.learn.eye_views import sequences
from priors.learn.lidar_scene import LidarScene
from priors.learn.moment import STREET, Moment, Scan
from priors.learn.real_scenes import HELD_OUT
from priors.learn.real_truth import DRIVE, KITTI2015, RAW, RealTruth, label_with_error
from priors.learn.real_views import OFFSETS_PX, SLOW
from priors.learn.sample_folder import SampleFolder
from priors.learn.stereo_data import HELD_BACK_EVERY
from priors.learn.stereo_pair import StereoPair
from priors.learn.warp_scenes import SLOW as SLOW_FOLDER
from priors.pairs.matching import match
from priors.pairs.rectification import RectificationError
from priors.sky import sky_mask
from priors.street import rig
from priors.types import Frame

ODOMETRY = "odometry"
VALIDATED = {KITTI2015: 8, DRIVE: 4, SLOW: 4, ODOMETRY: 4, STREET: 6}
"""How many moments of a source are validated on."""


@dataclass(frozen=True)
class Candidate:
    """A moment that can be made."""

    source: str
    name: str
    make: Callable[[], Moment]


def candidates(data: Path | None, street: Path) -> tuple[list[Candidate], list[Candidate]]:
    """List what there is to train on and what is held back for validation; nothing is made yet.

    Args:
        data: folder that holds kitti_stereo2015, kitti_raw_train, kitti_odometry or some of them; None: streets only.
        street: folder of rendered samples.

    Raises DataError where there are no samples.
    """
    train, held = [], []
    real = [] if data is None else [_with_truth(data), _slow(data), _odometry(data)]
    for found in (*real, _street(street)):
        train += found[0]
        for source, count in VALIDATED.items():
            held += pick_evenly([one for one in found[1] if one.source == source], count)
    return train, held


def _with_truth(data: Path) -> tuple[list[Candidate], list[Candidate]]:
    truth = RealTruth(data)
    train = [_truth_candidate(source, at, f) for source, frames in truth.frames.items() for at, f in enumerate(frames)]
    held = [_truth_candidate(KITTI2015, at, frame) for at, frame in enumerate(truth.held_back)]
    if (data / RAW).is_dir():
        drive = KittiRaw(data / RAW)
        held += [_truth_candidate(DRIVE, at, drive[at]) for at in held_back(drive)]
    return train, held


def _truth_candidate(source: str, at: int, frame: Frame) -> Candidate:
    return Candidate(source, frame.id, partial(_of_truth, source, at, frame))


def _of_truth(source: str, at: int, frame: Frame) -> Moment:
    """Make a moment of a pair with truth; accumulated sweeps where the truth is made of sweeps."""
    pair, error = label_with_error(frame, source)
    scan = None
    if frame.has("sweep"):
        official = frame.has("truth")
        scene = own_scene(frame, np.zeros(frame.camera.size, np.float32), source) if official else _scene(frame, source)
        scan = _scan(scene, at)
    return replace(_of_pair(pair, frame, error), scan=scan)


def _scene(frame: Frame, source: str) -> LidarScene:
    return scenes_of([frame], source)[0]


def _scan(scene: LidarScene, at: int) -> Scan:
    """Return what the LiDAR of a scene saw, with one of its accumulated maps: frames take turns."""
    counts = [INPUTS[at % len(INPUTS)]] if scene.accumulated_m else []
    accumulated_m = {count: scene.accumulated_m[count] for count in counts}
    return Scan(scene.points_m, scene.beam, scene.T_cam_lidar, accumulated_m)


def _of_pair(pair: StereoPair, frame: Frame, error: RectificationError) -> Moment:
    """Make a moment of a labelled pair: what weighs less than 1 is a match."""
    true = (pair.weight == 1) & ~pair.sky
    matched = (pair.weight > 0) & ~true & ~pair.sky
    weight = float(pair.weight[matched].max(initial=0))
    maps = [np.where(mask, pair.disparity_px, np.float32(0)) for mask in (true, matched)]
    baseline_m = frame.baseline_m
    if baseline_m is None:
        raise ValueError(f"frame {frame.id}: a pair without a baseline")
    views = pair.left, pair.right
    return Moment(pair.source, frame.id, *views, frame.camera, baseline_m, maps[0], maps[1], weight, pair.sky, error)


def _slow(data: Path) -> tuple[list[Candidate], list[Candidate]]:
    """List the slow colour drive's frames, which have one eye and no poses: its sweeps are registered all at once."""
    if not (data / SLOW_FOLDER).is_dir():
        return [], []
    drive = KittiRaw(data / SLOW_FOLDER)

    @cache
    def scenes() -> list[LidarScene]:
        return scenes_of([drive[at] for at in range(len(drive))], SLOW)

    def make(at: int) -> Moment:
        scene = scenes()[at]
        true_px = convert_disparity(scene.truth_m, scene.camera.fx, rig.BASELINE_M)
        nothing, sky = np.zeros_like(true_px), sky_mask(scene.image) & (true_px == 0)
        known = scene.image, None, scene.camera, rig.BASELINE_M, true_px, nothing, 0.0, sky
        return Moment(SLOW, drive.ids[at], *known, scan=_scan(scene, at))

    found = [Candidate(SLOW, id_, partial(make, at)) for at, id_ in enumerate(drive.ids)]
    return found[HELD_OUT:], found[:HELD_OUT]


def _odometry(data: Path) -> tuple[list[Candidate], list[Candidate]]:
    train: list[Candidate] = []
    held: list[Candidate] = []
    for sequence in sequences(data) if (data / "kitti_odometry").is_dir() else []:
        for number, candidate in _sequence(sequence):
            (train if number % HELD_BACK_EVERY else held).append(candidate)
    return train, held


def _sequence(folder: Path) -> Iterator[tuple[int, Candidate]]:
    drive = KittiOdometry(folder, "image_0")
    error = RectificationError(*OFFSETS_PX.get(folder.name, ()))

    def make(at: int) -> Moment:
        frame = drive[at]
        left, right = frame.image(), frame.other()
        pair = pseudo_labels.label(left, right, match(left, right))
        return replace(_of_pair(pair, frame, error), name=f"{folder.name}_{frame.id}")

    for at, id_ in enumerate(drive.ids):
        yield int(id_), Candidate(ODOMETRY, f"{folder.name}_{id_}", partial(make, at))


def _street(folder: Path) -> tuple[list[Candidate], list[Candidate]]:
    samples = SampleFolder(folder)

    def listed(paths: Sequence[Path]) -> list[Candidate]:
        return [Candidate(STREET, path.stem, partial(_of_sample, path)) for path in paths]

    return listed(samples.train), listed(samples.validation)


def _of_sample(path: Path) -> Moment:
    """Make a moment of a rendered sample; DataError where it has no camera or LiDAR."""
    scene, pair = lidar_scene.read_street(path), pair_file.read(path)
    if pair.sensors is None:
        raise ValueError(f"{path}: read_street takes samples with sensors only")
    baseline_m, nothing = pair.sensors.baseline_m, np.zeros_like(pair.disparity_px)
    known = pair.left, pair.right, scene.camera, baseline_m, pair.disparity_px, nothing, 0.0, pair.sky
    return Moment(STREET, path.stem, *known, scan=Scan(scene.points_m, scene.beam, scene.T_cam_lidar))
