"""Frames with real truth that no network of ours was trained on: trainings leave them out, figures are made on them.

| drive | held back | trains |
|---|---|---|
| KITTI 2015, training split | 022-025, 038-041, 069-072, 125-128: blocks, for neighbours look alike | the others |
| KITTI raw 2011_09_26 drive 0009 | frames 26-50 | frames 0-25 |
| KITTI raw 2011_09_26 drive 0001 | all: it is the test drive | nothing |

    positions = held_back(open_drive(Path("kitti_stereo2015")))
"""

import re
from dataclasses import replace

from priors.errors import DataError
from priors.types import Drive, Frame, Sweep

Block = tuple[int, int]
"""First and last frame number of neighbours that are held back together."""
EVERYTHING: Block = (0, 10**7)
BLOCKS: dict[str, tuple[Block, ...]] = {
    "kitti_stereo2015_training": ((22, 25), (38, 41), (69, 72), (125, 128)),
    "2011_09_26_drive_0009": ((26, 50),),
    "2011_09_26_drive_0001": (EVERYTHING,),
}
"""By the name of the drive, up to what tells its camera or its kind (`_sync`)."""
NUMBER = re.compile(r"\d+")


def is_held_back(drive: str, frame_id: str) -> bool:
    """Tell whether a frame is held back.

    Args:
        drive: the drive's name; that of one of its cameras is as good.
        frame_id: the frame's id: its first number counts.
    """
    found, number = _blocks(drive), NUMBER.search(frame_id)
    return number is not None and any(first <= int(number[0]) <= last for first, last in found)


def held_back(drive: Drive) -> list[int]:
    """Return the positions of a drive's frames that are held back; DataError where there are none."""
    found = [at for at, id_ in enumerate(drive.ids) if is_held_back(drive.name, id_)]
    if not found:
        raise DataError(f"{drive.name}: no frame of it is held back from training: {', '.join(BLOCKS)} have some")
    return found


def training_frames(drive: Drive) -> list[Frame]:
    """Return the frames of a drive that are not held back; the sweeps of those that are cannot be read beside them."""
    return [_apart(drive[at], drive.name) for at, id_ in enumerate(drive.ids) if not is_held_back(drive.name, id_)]


def _apart(frame: Frame, drive: str) -> Frame:
    read, number = frame.readers.get("sweep"), NUMBER.search(frame.id)
    if read is None or number is None:
        return frame

    def beside(offset: int = 0) -> Sweep | None:
        found: Sweep | None = None if is_held_back(drive, str(int(number[0]) + offset)) else read(offset)
        return found

    return replace(frame, readers={**frame.readers, "sweep": beside})


def _blocks(drive: str) -> tuple[Block, ...]:
    known = (blocks for name, blocks in BLOCKS.items() if re.fullmatch(rf"{name}(_sync|_extract)?(-image_\d+)?", drive))
    return next(known, ())
