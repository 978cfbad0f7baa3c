"""Training and validation data of stereo networks: real pairs with truth or labels, the street, warped single images.

    folders = Folders(Path("samples"), real=Path("../shared/data"))
    pair = mixture(folders)(np.random.default_rng([seed, step]))

Held back from training: every tenth world of the street, the odometry's frames 0, 10, 20 ..., and of the frames with
truth what priors/held_back.py says.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from priors.adapt.training_frames import pick_evenly
from priors.adapt.training_step import Batch
from priors.adapt.views import to_tensor
from priors.learn import pair_file, stereo_augment, warp
from priors.learn.crop_pack import CropPack
from priors.learn.eye_views import RIGHT
from priors.learn.moment import Moment
from priors.learn.pseudo_labels import label_drives
from priors.learn.real_truth import DRIVE, KITTI2015, label_frames, label_held_back
from priors.learn.sample_folder import SampleFolder
from priors.learn.stereo_augment import REAL, RENDERED
from priors.learn.stereo_pair import StereoPair, crop
from priors.learn.warp_scenes import CAMVID, SLOW_NAME, make_scenes

Draw = Callable[[np.random.Generator], StereoPair]
SHARES = {"street": 0.55, "warped": 0.25, "odometry": 0.2}
"""Of what is drawn; a source that is not there leaves its share to the others."""
SHARES_WITH_TRUTH = {"street": 0.33, "warped": 0.08, "odometry": 0.11, KITTI2015: 0.4, DRIVE: 0.08}
"""The same where there are real pairs with truth."""
LEAST_KNOWN = 0.1
"""Share of a crop that must be known; what has less is drawn again."""
ATTEMPTS = 5
HELD_BACK_EVERY = 10
KITTI_SHARE = 0.5
"""Of the warped pairs, the share that KITTI's own images make; the rest are CamVid's."""
MULTIPLE = 2
"""Heights and widths that validation looks at are multiples of this."""


@dataclass(frozen=True)
class Folders:
    """Where the data lies."""

    street: Path
    """Rendered samples (`priors train samples`)."""
    real: Path | None = None
    """Holds kitti_odometry, kitti_raw_train and camvid, or some of them; None: the street only."""
    cache: Path | None = None
    """Where prepared real data is kept; default: `real` beside the street's folder."""
    teacher: Path | None = None
    """A teacher's maps of the odometry frames, see teacher_labels.py."""


@dataclass(frozen=True)
class Sources:
    """Files to draw from: those for training, or those held back."""

    street: Sequence[Path]
    kitti: Sequence[Path] = ()
    """KITTI's images with a disparity map (warp.DisparityImage)."""
    camvid: Sequence[Path] = ()
    """CamVid's."""
    odometry: Sequence[Path] = ()
    """Labelled pairs."""
    kitti2015: Sequence[Path] = ()
    """Pairs with official truth."""
    drive0009: Sequence[Path] = ()
    """Pairs with accumulated sweeps."""

    def drawn(self) -> dict[str, Sequence[Path]]:
        """Return what there is to draw from, by the names of SHARES."""
        warped = [*self.kitti, *self.camvid]
        named = {"street": self.street, "warped": warped, "odometry": self.odometry}
        return {
            name: paths for name, paths in (named | {KITTI2015: self.kitti2015, DRIVE: self.drive0009}).items() if paths
        }


def find_sources(folders: Folders) -> tuple[Sources, Sources]:
    """Find what there is to train on and what is held back; what real data needs is prepared once, in minutes."""
    samples = SampleFolder(folders.street)
    if folders.real is None:
        return Sources(samples.train), Sources(samples.validation)
    cache = folders.cache or folders.street.parent / "real"
    labelled = label_drives(folders.real, cache / "labels", folders.teacher)
    scenes = make_scenes(folders.real, labelled, cache / "scenes", folders.teacher)
    camvid = [path for path in scenes if path.stem.startswith(CAMVID)]
    kitti, kitti_held = split_frames([path for path in scenes if not path.stem.startswith(CAMVID)])
    pairs, pairs_held = split_frames(labelled)
    true = label_frames(folders.real, cache / "truth")
    true_held = label_held_back(folders.real, cache / "truth")
    train = Sources(samples.train, kitti, camvid, pairs, true.get(KITTI2015, ()), true.get(DRIVE, ()))
    return train, Sources(samples.validation, kitti_held, (), pairs_held, true_held)


def split_frames(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Split files into those to train on and those whose frame number is a multiple of ten, with both their views."""

    def is_held_back(path: Path) -> bool:
        return int(path.stem.removesuffix(RIGHT).rpartition("_")[2]) % HELD_BACK_EVERY == 0

    return [path for path in paths if not is_held_back(path)], [path for path in paths if is_held_back(path)]


def mixture(folders: Folders, size: tuple[int, int] = (256, 512)) -> Draw:
    """Return what draws a training pair, augmented and cropped to size; it follows from the generator's state alone."""
    train, _ = find_sources(folders)
    return _mixture({name: partial(_draw_pair, train, name, size) for name in train.drawn()}, size)


def packed_mixture(pack: CropPack, size: tuple[int, int] = (256, 512)) -> Draw:
    """Return the same of a pack of crops; nothing in it is warped."""

    def drawn(moments: list[Moment]) -> Draw:
        return lambda rng: moments[int(rng.integers(len(moments)))].pair()

    pairs = {name: [one for one in moments if one.right is not None] for name, moments in pack.train.items()}
    return _mixture({name: drawn(moments) for name, moments in pairs.items() if moments}, size)


def _mixture(present: dict[str, Draw], size: tuple[int, int]) -> Draw:
    wanted = SHARES_WITH_TRUTH if KITTI2015 in present or DRIVE in present else SHARES
    names = [name for name in wanted if name in present]
    shares = np.array([wanted[name] for name in names])

    def draw(rng: np.random.Generator) -> StereoPair:
        source = names[rng.choice(len(names), p=shares / shares.sum())]
        for _ in range(ATTEMPTS):
            ranges = RENDERED if source == "street" else REAL
            pair = stereo_augment.augment(present[source](rng), rng, size, ranges)
            if pair.known.mean() >= LEAST_KNOWN:
                break
        return pair

    return draw


def validation(folders: Folders, count: int = 24, warped: int = 2) -> list[StereoPair]:
    """Return pairs that `mixture` never draws from, whole and not augmented.

    Args:
        folders: where the data lies.
        count: how many of the street, as its held-back worlds have them.
        warped: how many pairs made of the training drive's colour images.

    Returns:
        The street's pairs, then one for each held-back odometry frame and each pair with truth, then the warped ones.
    """
    _, held = find_sources(folders)
    pairs = [pair_file.read(path) for path in pick_evenly(held.street, count)]
    pairs += [pair_file.read(path) for path in held.odometry if not path.stem.endswith(RIGHT)]
    pairs += [even(pair_file.read(path)) for path in held.kitti2015]
    slow = pick_evenly([path for path in held.kitti if path.stem.startswith(SLOW_NAME)], warped)
    for number, path in enumerate(slow):
        filler = pair_file.read_left(slow[number - 1])[::-1]
        pairs.append(even(warp.warp(pair_file.read_disparity_image(path), np.ascontiguousarray(filler))))
    return pairs


def packed_validation(pack: CropPack) -> list[StereoPair]:
    """Return the pairs of a pack that are held back."""
    return [even(one.pair()) for moments in pack.held_back.values() for one in moments if one.right is not None]


def collate(pairs: Sequence[StereoPair]) -> Batch:
    """Stack pairs of one size: left, right (b, 3, h, w), channels-last; disparity_px, sky, weight (b, h, w).

    All are float32, colours in [0, 1]; the sky is 1, else 0.
    """
    maps: dict[str, list[npt.NDArray[Any]]] = {
        "disparity_px": [pair.disparity_px for pair in pairs],
        "sky": [pair.sky for pair in pairs],
        "weight": [pair.weight for pair in pairs],
    }
    return {
        "left": to_tensor([pair.left for pair in pairs]),
        "right": to_tensor([pair.right for pair in pairs]),
        **{name: torch.from_numpy(np.stack(values).astype(np.float32)) for name, values in maps.items()},
    }


def even(pair: StereoPair) -> StereoPair:
    """Cut off what is beyond a multiple of MULTIPLE."""
    height, width = pair.sky.shape
    return crop(pair, 0, 0, (height - height % MULTIPLE, width - width % MULTIPLE))


def _draw_pair(sources: Sources, source: str, size: tuple[int, int], rng: np.random.Generator) -> StereoPair:
    if source != "warped":
        return pair_file.read(_draw_path(sources.drawn()[source], rng))
    groups = [group for group in (sources.kitti, sources.camvid) if group]
    group = groups[0] if rng.random() < KITTI_SHARE else groups[-1]
    scene = pair_file.read_disparity_image(_draw_path(group, rng))
    return warp.draw_pair(scene, pair_file.read_left(_draw_path(groups[-1], rng)), rng, size)


def _draw_path(paths: Sequence[Path], rng: np.random.Generator) -> Path:
    return paths[int(rng.integers(len(paths)))]
