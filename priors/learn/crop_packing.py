"""The making of a pack of training crops (crop_pack.py), as many as there is room for.

    pack_crops(PackRequest(Path("crops"), Path("samples"), Path("../shared/data"), mib=36))

A run that was stopped goes on: a crop that is there is not made again.
"""

import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eval.files import write_bytes
from priors.errors import DataError
from priors.learn import moment_file
from priors.learn.crop_pack import HELD_BACK, RECORD, TRAIN
from priors.learn.moment import STREET, Moment
from priors.learn.real_moments import ODOMETRY, Candidate, candidates
from priors.learn.real_truth import DRIVE, KITTI2015
from priors.learn.real_views import SLOW

WINDOW = (320, 640)
"""Height and width of a crop: trainings cut 256x512 out of it, stretched."""
SHARES = {KITTI2015: 0.45, DRIVE: 0.17, SLOW: 0.1, ODOMETRY: 0.1, STREET: 1.0}
"""Of the room for training crops, at most; the last source has all that is left."""
RECORD_BYTES = 4096


@dataclass(frozen=True)
class PackRequest:
    """What a pack is made of, and how large it may be."""

    out: Path
    street: Path
    """Rendered samples."""
    real: Path | None
    """Real data; None: streets only."""
    mib: float
    """Of all files together."""

    def too_small(self) -> DataError:
        """Return the error of a pack whose room does not hold crops of every source."""
        return DataError(f"--mib {self.mib:g}: no room for crops of all sources: give it more, or leave --real out")


def pack_crops(request: PackRequest, on_percent: Callable[[], None] = lambda: None) -> dict[str, int]:
    """Write a pack; returns how many training crops of each source it holds, and how many are held back.

    Args:
        request: what goes into it.
        on_percent: called whenever another hundredth of the room is used.

    Raises DataError where the samples are missing, or the room does not even hold what is validated on.
    """
    train, held = candidates(request.real, request.street)
    room = int(request.mib * 2**20) - RECORD_BYTES
    (request.out / RECORD).unlink(missing_ok=True)
    packing = _Packing(request.out, room, on_percent)
    for one in held:
        if not packing.add(one, HELD_BACK, room):
            raise request.too_small()
    for_training = room - packing.used
    for source, share in SHARES.items():
        found = [one for one in train if one.source == source]
        limit = packing.used + int(share * for_training)
        for at in spread(len(found)):
            if not packing.add(found[at], TRAIN, min(limit, room)):
                break
    packing.drop_others()
    if not packing.counts.get(STREET):
        raise request.too_small()
    record = {"window": WINDOW, "quality": moment_file.QUALITY, "bytes": packing.used, "crops": packing.counts}
    write_bytes(request.out / RECORD, json.dumps(record, indent=1).encode())
    return packing.counts


class _Packing:
    """A pack that is being written."""

    def __init__(self, out: Path, room: int, on_percent: Callable[[], None]) -> None:
        self.out, self.room, self.on_percent = out, room, on_percent
        self.used, self.counts, self._kept = 0, dict[str, int](), set[Path]()

    def add(self, one: Candidate, folder: str, limit: int) -> bool:
        """Write a crop unless it is there; False, and no crop, where it does not fit below the limit, bytes."""
        path = self.out / folder / f"{one.source}_{one.name}.npz"
        if not path.exists():
            moment_file.write(path, window_of(one.make(), middle=folder == HELD_BACK))
        size = path.stat().st_size
        if self.used + size > limit:
            return False
        for _ in range(100 * self.used // self.room, 100 * (self.used + size) // self.room):
            self.on_percent()
        self.used += size
        self._kept.add(path)
        key = one.source if folder == TRAIN else HELD_BACK
        self.counts[key] = self.counts.get(key, 0) + 1
        return True

    def drop_others(self) -> None:
        """Delete the crops that did not fit, and those of an earlier, larger pack."""
        for folder in (TRAIN, HELD_BACK):
            for path in (self.out / folder).glob("*.npz"):
                if path not in self._kept:
                    path.unlink()


def window_of(moment: Moment, *, middle: bool) -> Moment:
    """Cut a crop out of a whole moment: at its foot in the middle, or at a place that its name decides."""
    size = min(WINDOW[0], moment.sky.shape[0]), min(WINDOW[1], moment.sky.shape[1])
    above, beside = (moment.sky.shape[side] - size[side] for side in (0, 1))
    rng = np.random.default_rng(zlib.crc32(f"{moment.source} {moment.name}".encode()))
    left = beside // 2 if middle else int(rng.integers(beside + 1))
    top = above if middle else int(rng.integers(above // 2, above + 1))
    return moment.cut(top, left, size)


def spread(count: int) -> Iterator[int]:
    """Yield the numbers below count so that the first ones, however many, lie evenly (van der Corput's order)."""
    bits = max(1, (count - 1).bit_length())
    for number in range(1 << bits):
        turned = int(f"{number:0{bits}b}"[::-1], 2)
        if turned < count:
            yield turned
