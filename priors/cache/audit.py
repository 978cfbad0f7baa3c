"""The audit of a prior: every map is read; what is damaged, stale, not verified or nobody's is listed."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from eval.files import STALE_S
from priors.cache.learned import Freshness
from priors.cache.prior import CONFIDENCES, Prior
from priors.cache.sources import Digests
from priors.errors import DataError
from priors.types import Drive


@dataclass(frozen=True)
class Audit:
    """What was found in a prior's folder."""

    prior: Prior
    verified: list[str] = field(default_factory=list)
    """Ids of the frames whose maps are what was written."""
    unverified: list[str] = field(default_factory=list)
    """Ids of the frames whose maps can be read, and have no checksum: an earlier version or another tool made them."""
    damaged: dict[str, str] = field(default_factory=dict)
    """Frame id -> what is wrong with its maps."""
    stale: dict[str, str] = field(default_factory=dict)
    """Frame id -> which file is not what its map was made of."""
    orphans: list[str] = field(default_factory=list)
    """Files that belong to no map, by their names in the folder."""


def audit(prior: Prior, drive: Drive | None, on_frame: Callable[[str], None] = lambda frame_id: None) -> Audit:
    """Read all maps of a prior; the journal is told of damaged ones, where it can be.

    Args:
        prior: whose maps.
        drive: its drive; without it nothing is said of stale maps and of maps of no frame.
        on_frame: told the id of each frame when it was read.
    """
    found = Audit(prior)
    for frame_id in prior.ids():
        try:
            prior.read(frame_id)
            known = prior.is_recorded(frame_id)
            (found.verified if known else found.unverified).append(frame_id)
        except DataError as error:
            found.damaged[frame_id] = str(error).removeprefix(f"{prior.folder}{os.sep}")
        on_frame(frame_id)
    if drive is not None:
        found.stale.update(_stale(prior, drive))
    found.orphans.extend(_orphans(prior, None if drive is None else set(drive.ids)))
    return found


def _stale(prior: Prior, drive: Drive) -> Iterator[tuple[str, str]]:
    freshness, lines = Freshness(prior.folder, drive, Digests()), prior.lines()
    for index, frame_id in enumerate(drive.ids):
        if frame_id not in lines or not prior.depth_path(frame_id).exists():
            continue
        try:
            if reason := freshness.why_stale(lines[frame_id].get("made_of"), drive[index]):
                yield frame_id, reason
        except DataError as error:
            yield frame_id, str(error)


def _orphans(prior: Prior, known: set[str] | None) -> Iterator[str]:
    """Name the files beside the maps that belong to none; temporary ones only once nobody can be writing them."""
    maps = set(prior.ids())
    for kind in ("depth", *CONFIDENCES):
        folder = prior.folder / kind
        for path in sorted(folder.iterdir()) if folder.is_dir() else []:
            if path.name.startswith(".") and not _is_old(path):
                continue
            is_map = path.suffix == ".png" and not path.name.startswith(".") and path.stem in maps
            if not is_map or (known is not None and path.stem not in known):
                yield f"{kind}/{path.name}"


def _is_old(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > STALE_S
    except OSError:
        return False
