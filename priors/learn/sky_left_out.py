"""How well the sky mask does on recordings that it has not seen: each of CamVid's is left out in turn.

    python -m priors.learn.sky_left_out runs/sky-left-out --data ../shared/data --streets street21 street22 --steps 450

The network is trained as fit_sky.py does, without teachers, on everything but one recording of CamVid and one place of
KITTI, and scored on all labelled frames of these two, of whatever split. CamVid's validation split alone would
flatter: its recording is in the training split too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from priors.errors import DataError
from priors.learn.config import TrainConfig
from priors.learn.fit_sky import SkyTask, read_labelled, tell
from priors.learn.loop import train
from priors.learn.sky_labels import SkySample, read_camvid

LEFT_OUT = (("0001", "06"), ("0006", "01"), ("0016", "image_02"))
"""CamVid's recordings with labels at hand, 0001TP (dusk), 0006R0 and 0016E5, and KITTI's places: one of each at a time."""


@dataclass(frozen=True)
class SkyLeftOut:
    """Score the sky mask on recordings that its training did not see."""

    out: Annotated[Path, tyro.conf.Positional]
    """Folder of the runs, one a recording."""
    data: Path
    """Folder that holds camvid, kitti_odometry and kitti_raw_train."""
    streets: tuple[Path, ...] = ()
    """Folders written by `priors street`."""
    how: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def main(arguments: list[str] | None = None) -> None:
    """Print the IoU of every recording left out and the mean; takes the command line's arguments."""
    asked = tyro.cli(SkyLeftOut, args=arguments, description=__doc__)
    samples = [*read_labelled(asked.data, asked.streets), *read_camvid(asked.data / "camvid", "val")]
    found = []
    for task, places in left_out(samples):
        scores = train(task, asked.out / places[0], asked.how, on_step=tell)
        found.append(scores[places[0]])
        for place in places:
            print(f"{place} left out: IoU {scores[place]:.3f}", flush=True)
    print(f"mean of CamVid's {len(found)}: {np.mean(found):.3f}")


def left_out(samples: Sequence[SkySample]) -> Iterator[tuple[SkyTask, tuple[str, ...]]]:
    """Give for each recording the training without it, and which places are judged.

    Raises DataError where nothing else is there to learn from.
    """
    there = {sample.place for sample in samples}
    for pair in LEFT_OUT:
        places = tuple(place for place in pair if place in there)
        others = [sample for sample in samples if sample.place not in pair]
        if not others or pair[0] not in there:
            raise DataError(f"sky: samples of {', '.join(sorted(there)) or 'no place'}: needs {pair[0]} and others")
        yield SkyTask(others, [sample for sample in samples if sample.place in places]), places


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
