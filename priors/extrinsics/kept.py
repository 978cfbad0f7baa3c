"""What was measured of a drive, kept beside its priors: measured once, and again where the frames have changed.

<folder>/extrinsics-<key>.json      turn, delay, place, errors, frames, and the files that they were measured in
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from priors.cache.learned import WatchedDrive, why_learned_stale
from priors.cache.sources import Digests
from priors.errors import DataError
from priors.extrinsics.measure import measure, spread_frames
from priors.extrinsics.measured import Measured
from priors.keys import key_of
from priors.types import Drive, Frame

VERSION = 3
"""Raised when what is measured changes."""
FORMAT, MADE_OF = 1, "made_of"


def measured_on(drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None) -> Measured:
    """Return what a drive's frames show of its extrinsics: as kept in a folder, else measured now and kept there.

    Args:
        drive: all of it: which frames are looked at depends on nothing else.
        folder: where to keep it.
        on_note: told what was found, a line.

    Raises:
        DataError: the frames show too little.
    """
    places = spread_frames(drive)
    ids = [drive.ids[place] for place in places]
    path = folder / f"extrinsics-{key_of({'version': VERSION, 'drive': drive.fingerprint(), 'frames': ids})}.json"
    kept = _read(path, drive)
    if kept is not None:
        on_note(f"LiDAR and camera: {kept}, measured before: {path}")
        return kept
    watched = drive if isinstance(drive, WatchedDrive) else WatchedDrive(drive)
    try:
        measured = measure([frame for place in places if (frame := _open(watched, place)) is not None])
    except DataError as error:
        raise DataError(f"{drive.name}: {error}: leave --lidar.extrinsics out") from error
    record = {"format": FORMAT, **measured.record(), MADE_OF: watched.sources(Digests())}
    write_bytes(path, (json.dumps(record, indent=1) + "\n").encode())
    on_note(f"LiDAR and camera: {measured}, measured on {len(measured.frames)} frames: {path}")
    return measured


def _open(drive: Drive, place: int) -> Frame | None:
    try:
        return drive[place]
    except DataError:
        return None  # it is told where the frame is used


def _read(path: Path, drive: Drive) -> Measured | None:
    """Return what is kept, where the files that it was measured in hold the same; a watched drive is told of them."""
    try:
        record: dict[str, Any] = json.loads(path.read_bytes())
        measured = Measured.restore(record)
        made_of = dict(record[MADE_OF])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # none, or damaged: it is measured again
    plain = drive.drive if isinstance(drive, WatchedDrive) else drive
    if record.get("format") != FORMAT or why_learned_stale(made_of, plain, Digests()) is not None:
        return None
    if isinstance(drive, WatchedDrive):
        drive.learned_before(made_of)
    return measured
