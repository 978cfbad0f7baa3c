"""What stereo networks are trained and validated on: the street, pairs made of single real images, labelled real pairs.

    draw = mixture(street, real=Path("../shared/data"), cache=Path("cache"))
    item = draw(np.random.default_rng([seed, step]))        # see pair.to_item

Held back from training: every tenth world of the street, the real drives' frames 0, 10, 20 ...
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from priors.learn import pseudo, scenes, warp
from priors.learn.lidar_scene import Streets
from priors.learn.stereo_augment import USUAL, Variation, vary
from priors.learn.stereo_pair import Item, Pair, crop, from_street, to_item

Draw = Callable[[np.random.Generator], Item]
SHARES = {"street": 0.55, "warped": 0.25, "odometry": 0.2}
"""Of what is drawn; a source that is not there leaves its share to the others."""
LEAST_KNOWN = 0.1
"""Share of a crop that must be known; what has less is drawn again."""
ATTEMPTS = 5
CRISP, BLACK = 1.3, -4.0
"""Rendered streets have less contrast and paler blacks than KITTI's and CamVid's images: looks.Range."""
HELD_BACK_EVERY = 10
FOLLOWED = 0.5
"""Of the warped ones, the share of KITTI's own images; the rest is CamVid."""


@dataclass(frozen=True)
class Sources:
    """Files to draw from; those for training, or those held back."""

    street: Sequence[Path]
    kitti: Sequence[Path] = ()
    """Scenes (warp.Scene) of KITTI's images."""
    camvid: Sequence[Path] = ()
    """Scenes of CamVid's."""
    odometry: Sequence[Path] = ()
    """Labelled pairs."""


def find(
    street: Path, real: Path | None = None, cache: Path | None = None, teacher: Path | None = None
) -> tuple[Sources, Sources]:
    """Find what there is to train on and what is held back; what real data needs is prepared once, in minutes.

    Args:
        street: folder of rendered samples.
        real: folder that holds kitti_odometry, kitti_raw_train and camvid, or some of them; None: the street only.
        cache: where prepared real data is kept; default: `real` beside the street's folder.
        teacher: folder of a teacher's maps of the odometry frames, see learn/teacher_labels.py.
    """
    streets = Streets(street)
    if real is None:
        return Sources(streets.train), Sources(streets.validation)
    cache = cache or street.parent / "real"
    labelled = pseudo.prepare(real, cache / "labels", teacher)
    made = scenes.prepare(real, labelled, cache / "scenes", teacher)
    kitti, kitti_held = _part([path for path in made if not path.stem.startswith("camvid")])
    camvid = [path for path in made if path.stem.startswith("camvid")]
    pairs, pairs_held = _part(labelled)
    return (
        Sources(streets.train, kitti, camvid, pairs),
        Sources(streets.validation, kitti_held, camvid[:0], pairs_held),
    )


def mixture(
    street: Path,
    real: Path | None = None,
    cache: Path | None = None,
    teacher: Path | None = None,
    crop: tuple[int, int] = (256, 512),
    shares: dict[str, float] | None = None,
    variation: Variation = USUAL,
) -> Draw:
    """Return what draws a training item of size crop; the item follows from the generator's state alone.

    See `find` for the folders, pair.to_item for the item, SHARES for shares.
    """
    train, _ = find(street, real, cache, teacher)
    present = {"street": train.street, "warped": [*train.kitti, *train.camvid], "odometry": train.odometry}
    wanted = {name: share for name, share in (shares or SHARES).items() if present[name]}
    rendered = replace(variation, look=replace(variation.look, crisp=CRISP, black=BLACK))
    names, share = list(wanted), np.array(list(wanted.values()))

    def draw(rng: np.random.Generator) -> Item:
        source = names[rng.choice(len(names), p=share / share.sum())]
        for _ in range(ATTEMPTS):
            how = rendered if source == "street" else variation
            item = to_item(vary(_draw(train, source, rng, crop), rng, crop, how))
            if item["known"].mean() >= LEAST_KNOWN:
                break
        return item

    return draw


def validation(
    street: Path,
    real: Path | None = None,
    cache: Path | None = None,
    teacher: Path | None = None,
    count: int = 24,
    warped: int = 2,
) -> list[Item]:
    """Return items that `mixture` never draws from, whole and not varied.

    Args:
        street: as in `find`.
        real: as in `find`.
        cache: as in `find`.
        teacher: as in `find`.
        count: how many of the street, as its held-back worlds have them.
        warped: how many pairs made of the training drive's colour images.

    Returns:
        The street's items, then one for each held-back odometry frame, then the warped ones.
    """
    _, held = find(street, real, cache, teacher)
    items = [to_item(from_street(path)) for path in _spread(held.street, count)]
    items += [to_item(pseudo.read(path)) for path in held.odometry if not path.stem.endswith("_right")]
    slow = _spread([path for path in held.kitti if path.stem.startswith("slow")], warped)
    for number, path in enumerate(slow):
        scene = warp.read(path)
        filler = warp.read_image(slow[number - 1])[::-1]
        pair = warp.warp(scene, np.ascontiguousarray(filler))
        items.append(to_item(crop_whole(pair)))
    return items


def collate(items: Sequence[Item]) -> dict[str, Tensor]:
    """Stack items of one size: left, right (b, 3, h, w), channels-last; disparity_px, known, sky, weight (b, h, w).

    All float32; known and sky are 0 or 1.
    """
    batch = {}
    for field in ("left", "right"):
        stacked = np.stack([item[field].transpose(1, 2, 0) for item in items])
        batch[field] = torch.from_numpy(stacked).permute(0, 3, 1, 2)
    for field in ("disparity_px", "known", "sky", "weight"):
        batch[field] = torch.from_numpy(np.stack([item[field] for item in items]).astype(np.float32))
    return batch


def crop_whole(pair: Pair, multiple: int = 2) -> Pair:
    """Crop a pair so that its sides are multiples."""
    height, width = pair.sky.shape
    return crop(pair, 0, 0, (height - height % multiple, width - width % multiple))


def _draw(sources: Sources, source: str, rng: np.random.Generator, crop: tuple[int, int]) -> Pair:
    if source == "street":
        return from_street(_choose(sources.street, rng))
    if source == "odometry":
        return pseudo.read(_choose(sources.odometry, rng))
    groups = [group for group in (sources.kitti, sources.camvid) if group]
    group = groups[0] if rng.random() < FOLLOWED else groups[-1]
    scene, filler = warp.read(_choose(group, rng)), warp.read_image(_choose(groups[-1], rng))
    return warp.draw(scene, filler, rng, crop)


def _choose(paths: Sequence[Path], rng: np.random.Generator) -> Path:
    return paths[int(rng.integers(len(paths)))]


def _part(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Part files into those to train on and those whose frame number is a multiple of ten, with both their views."""
    numbers = [int(path.stem.removesuffix("_right").rpartition("_")[2]) for path in paths]
    out = [number % HELD_BACK_EVERY == 0 for number in numbers]
    first = [path for path, is_out in zip(paths, out, strict=True) if not is_out]
    return first, [path for path, is_out in zip(paths, out, strict=True) if is_out]


def _spread(paths: Sequence[Path], count: int) -> Sequence[Path]:
    """Return count of the paths, evenly spread."""
    if len(paths) <= count:
        return paths
    return [paths[round(index)] for index in np.linspace(0, len(paths) - 1, count)]
