"""Prepare: every 'auto' is decided and the prior's place in the cache is found; no map is made."""

from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from priors import cache, keys
from priors.build.chains import VERSION as REUSE_VERSION
from priors.build.chains import check_reuse
from priors.build.decided import ENTRY, decide
from priors.build.job import Job
from priors.build.temporal import Joined, expect_poses, record_of
from priors.cache import Prior
from priors.cache.manifest import NewerFormatError
from priors.cache.store import mirror, store_of
from priors.errors import DataError
from priors.filters import Filters
from priors.records import record
from priors.selection import first_readable
from priors.sky import VERSION as SKY_VERSION
from priors.types import Drive, Frame, Input, Method


def prepare(
    drive: Drive,
    method: Method,
    filters: Filters | None = None,
    folder: Path = Path("cache"),
    reuse: int = 1,
    temporal: int = 0,
) -> Job:
    """Decide every 'auto' and find the prior's place in the cache; no map is made.

    Args:
        drive: what to make depth for.
        method: how; 'auto' is decided on the drive's first frame.
        filters: what to leave out of the maps; default: nothing.
        folder: the cache, or its URL in an object store.
        reuse: frames at positions that are multiples of it are made whole, those after each of the one before.
        temporal: join each map with those of so many frames before and after it (priors/fusion/moments.py).

    Raises:
        UsageError: `reuse`, where the method or the drive does not allow it.
        DataError: no frame can be opened, the drive has no poses to join maps by, a name cannot be a file's,
            or a later version of roadprior made the prior.
    """
    filters = filters or Filters()
    _check_names(drive)
    folder = _here(folder, drive.name)
    frame = first_readable(drive)
    check_reuse(reuse, method, frame)
    home = folder / drive.name
    fingerprint = drive.fingerprint()
    method, decided = decide(method, frame, home, fingerprint)
    manifest = _manifest(drive, frame, method, filters) | {"fingerprint": fingerprint}
    if reuse > 1:
        manifest["reuse"] = {"frames": reuse, "version": REUSE_VERSION}
    kind: dict[str, Any] = {"reuse": reuse}
    if temporal:
        expect_poses(drive, frame)
        manifest["filters"] = {**record_of(temporal), **manifest["filters"]}
        kind = {"join": partial(Joined.open, prepare(drive, method, None, folder, reuse), temporal)}
    if decided is not None:
        manifest[ENTRY] = decided
    earlier = keys.find(home, manifest, type(method))
    if earlier is not None:
        prior = Prior(earlier.folder, {**manifest, "key": earlier.manifest["key"]})
        return Job(drive, method, filters, prior, **kind)
    key = keys.key(manifest, type(method))
    prior = Prior(home / f"{method.name}-{key}", {**manifest, "key": key})
    return Job(drive, method, filters, prior, _has_lost_manifest(prior), **kind)


def _here(folder: Path, drive: str) -> Path:
    """Return the cache, or a store's mirror with all of the drive but the maps."""
    here = mirror(folder)
    store = store_of(here)
    if store is not None:
        store.pull(drive, (".json", ".jsonl", ".safetensors"))
    return here


def _manifest(drive: Drive, frame: Frame, method: Method, filters: Filters) -> dict[str, Any]:
    """Return what a manifest says, but for the key."""
    return {
        "format": cache.FORMAT,
        "code": version("roadprior"),
        "method": method.name,
        "version": method.VERSION,
        "config": record(method),
        "filters": filters.record(),
        "sky": SKY_VERSION,
        "weights": method.weights_digest(),
        "maps": _maps_digest(frame, {*method.reads, *filters.reads}),
        "camera": {"K": frame.camera.K.tolist(), "size": list(frame.camera.size), "baseline_m": frame.baseline_m},
        "encoding": "kitti",
        "drive": {"name": drive.name, **drive.describe()},
    }


def _check_names(drive: Drive) -> None:
    """Raise DataError where the drive's name, or a frame's id, would lead out of the cache."""
    for what, name in (("drive", drive.name), *(("frame", id_) for id_ in drive.ids)):
        if not name or name.startswith(".") or "/" in name or "\0" in name or len(Path(name).parts) != 1:
            raise DataError(f"{what} {name!r}: cannot be a file's name in the cache: rename it")


def _has_lost_manifest(prior: Prior) -> bool:
    """Tell whether a prior has maps and a manifest that is damaged or missing; a later version's is refused."""
    if not prior.folder.is_dir():
        return False
    try:
        cache.load(prior.folder)
    except NewerFormatError:
        raise
    except DataError:
        return bool(prior.ids())
    return False


def _maps_digest(frame: Frame, reads: set[Input]) -> str | None:
    """Hash the first depth map that the method or a filter reads (--truth may name other maps for the same drive)."""
    maps = [frame.read(what) for what in sorted(reads & {"sparse", "truth"}) if frame.has(what)]
    return sha256(b"".join(depth.depth_m.tobytes() for depth in maps)).hexdigest() if maps else None
