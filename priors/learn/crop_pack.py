"""A pack of training crops: all that the trainings need beside a checkout, in one small folder that travels.

    CropPack(Path("crops")).train["kitti2015"]

PACK/train/<source>_<name>.npz        moments to learn from (moment_file.py)
    /held_back/<source>_<name>.npz    those to validate on: none of them is ever trained on
    /pack.json                        what there is; written last

`priors train pack-crops` makes it (crop_packing.py).
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from priors.errors import DataError
from priors.learn import moment_file
from priors.learn.moment import STREET, Moment
from priors.machine import threads

TRAIN, HELD_BACK, RECORD = "train", "held_back", "pack.json"


class CropPack:
    """The moments of a pack by source, in memory: some 1.5 MB each."""

    def __init__(self, folder: Path) -> None:
        """Read a pack; DataError where it is none, not whole, or damaged."""
        if not (folder / RECORD).is_file():
            raise DataError(f"{folder}: no whole pack of crops in it: make it with priors train pack-crops {folder}")
        self.folder = folder
        self.train, self.held_back = self._read(TRAIN), self._read(HELD_BACK)
        if not self.train.get(STREET):
            raise DataError(f"{folder}: no crops of a street in it: make it anew with priors train pack-crops")

    def _read(self, part: str) -> dict[str, list[Moment]]:
        found: dict[str, list[Moment]] = {}
        with ThreadPoolExecutor(threads.count()) as pool:
            for moment in pool.map(moment_file.read, sorted((self.folder / part).glob("*.npz"))):
                found.setdefault(moment.source, []).append(moment)
        return found
