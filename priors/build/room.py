"""Disk space of a build, estimated from the prior's maps that are there, else from the usual size of maps."""

from priors.cache import Prior
from priors.cache.prior import CONFIDENCES
from priors.machine import disk

LOOKED_AT = 32
"""Maps whose files are looked at, at most; evenly spread."""
TYPICAL, SPARSE = 3.5, {"lidar": 1.0}
"""Bytes of a pixel in depth and confidences together, of dense maps and of others: on drive 0009 of KITTI raw dense
ones take 2.0 (completion) to 3.8 (stereo), a LiDAR's 1.0 (tests/bench/bench_cost.py)."""
WHAT = "the maps"


def needed_bytes(prior: Prior, count: int) -> int:
    """Return about how many bytes `count` more maps of a prior take."""
    ids = prior.ids()
    some = ids[:: -(-len(ids) // LOOKED_AT)] if ids else []
    sizes = [size for id_ in some if (size := _size(prior, id_))]
    height, width = prior.manifest["camera"]["size"]
    typical = SPARSE.get(prior.manifest["method"], TYPICAL) * height * width
    return round(count * (sum(sizes) / len(sizes) if sizes else typical))


def expect_room(prior: Prior, count: int) -> None:
    """Raise DataError where the cache's disk is too small for `count` more maps; a store's is not asked."""
    if prior.store is None:
        disk.expect_room(prior.folder, needed_bytes(prior, count), WHAT)


def told(prior: Prior, count: int) -> str | None:
    """Return the line that says what `count` more maps take; None where that is little, or not on a disk here."""
    return None if prior.store is not None else disk.told(prior.folder, needed_bytes(prior, count), WHAT)


def _size(prior: Prior, id_: str) -> int:
    """Return how many bytes the files of a frame's maps take."""
    paths = [prior.path(kind, id_) for kind in ("depth", *CONFIDENCES)]
    return sum(path.stat().st_size for path in paths if path.exists())
