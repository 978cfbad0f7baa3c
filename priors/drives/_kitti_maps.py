"""Find KITTI's depth maps (`groundtruth`, `velodyne_raw`): other downloads than the images, unpacked in other places.

[train|val/]<drive>/proj_depth/{groundtruth,velodyne_raw}/{image_02,image_03}/0000000005.png
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path

from priors import codecs
from priors.drives._files import stems
from priors.errors import DataError

KINDS = {"truth": "groundtruth", "sparse": "velodyne_raw"}
"""What a frame reads a map as -> the data set's name for it."""
FOLDERS = ("kitti_depth", "data_depth_annotated", "data_depth_velodyne", "depth")


def given(truth: Path, drives: Sequence[str], camera: str) -> dict[str, dict[str, Path]]:
    """Map truth and sparse to {frame id: map} in the folder that --truth names; DataError where it has no truth.

    `drives` are the names that the drive's folder there may have.
    """
    roots = [truth, *(truth / name for name in FOLDERS)]
    maps = {what: _first(roots, drives, camera, kind) for what, kind in KINDS.items()}
    if not maps["truth"]:
        wanted = f"[train/]{drives[0]}/proj_depth/groundtruth/{camera}"
        raise DataError(f"{truth}: --truth should hold {wanted}, found none")
    return maps


def beside(above: list[Path], drives: Sequence[str], camera: str, size: tuple[int, int]) -> dict[str, dict[str, Path]]:
    """Map truth and sparse to {frame id: map} found above a drive; maps of another size are another drive's."""
    return {what: _first(_roots(above), drives, camera, kind, size) for what, kind in KINDS.items()}


def lacking(above: list[Path], drives: Sequence[str], camera: str, what: str) -> str:
    """Say why no map to be read as `what` is beside a drive, and what to do."""
    kind = KINDS[what]
    of_any_size = _first(_roots(above), drives, camera, kind)
    if of_any_size:
        return f"{next(iter(of_any_size.values())).parent}: these maps are for another image size: make them anew"
    return f"no proj_depth/{kind}/{camera} maps of {drives[0]} found beside: name their folder with --truth"


def _roots(above: list[Path]) -> list[Path]:
    return [*above, *(root / name for root in above for name in FOLDERS)]


def _first(
    roots: Iterable[Path], drives: Sequence[str], camera: str, kind: str, size: tuple[int, int] | None = None
) -> dict[str, Path]:
    for root in roots:
        for split, drive in product(("", "train", "val"), drives):
            maps = stems(root / split / drive / "proj_depth" / kind / camera, [".png"])
            if maps and (size is None or _fits(maps, size)):
                return maps
    return {}


def _fits(maps: dict[str, Path], size: tuple[int, int]) -> bool:
    """Tell whether the maps are for images of this size, by three of them.

    A map that is damaged, or of another size than the others, is reported when it is read, not here.
    """
    paths, shapes = list(maps.values()), []
    for path in dict.fromkeys((paths[0], paths[len(paths) // 2], paths[-1])):
        with suppress(DataError):
            shapes.append(codecs.read_depth_png(path).shape)
    return size in shapes or not shapes
