"""How well the sky mask does on recordings that it has not seen: each of CamVid's is left out in turn.

    python -m priors.learn.sky_left_out runs/sky-left-out --data ../shared/data --streets street21 street22 --steps 450

The network is trained as fit_sky.py does on everything but one recording of CamVid and one place of KITTI: first by
labels alone, then by KITTI frames too that this very network labels. It is scored on all labelled frames of the two, of
whatever split. CamVid's validation split alone would flatter: its recording is in the training split too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from priors.errors import DataError, expect_between
from priors.learn.config import MOST_STEPS, TrainConfig
from priors.learn.fit_sky import SkyTask, average, read_labelled, read_run, tell
from priors.learn.loop import train
from priors.learn.sky_evidence import read_evidence
from priors.learn.sky_labels import SkySample, read_camvid

LEFT_OUT = (("0001", "06"), ("0006", "01"), ("0016", "image_02"))
"""CamVid's recordings with labels at hand, 0001TP (dusk), 0006R0, 0016E5, and KITTI's places: one of each at a time."""


@dataclass(frozen=True)
class SkyLeftOut:
    """Score the sky mask on recordings that its training did not see."""

    out: Annotated[Path, tyro.conf.Positional]
    """Folder of the runs, one a recording."""
    data: Path
    """Folder that holds camvid, kitti_odometry and kitti_raw_train."""
    streets: tuple[Path, ...] = ()
    """Folders written by `priors street`."""
    taught_steps: int = 220
    """Steps of the second training."""
    how: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        expect_between(1, self.taught_steps, MOST_STEPS, "--taught-steps")


def main(arguments: list[str] | None = None) -> None:
    """Print the IoU of every recording left out and the mean; takes the command line's arguments."""
    asked = tyro.cli(SkyLeftOut, args=arguments, description=__doc__)
    samples = [*read_labelled(asked.data, asked.streets), *read_camvid(asked.data / "camvid", "val")]
    found = []
    for task, places in left_out(samples):
        scores = learn_twice(task, places, asked)
        found.append(scores[places[0]])
        for place in places:
            print(f"{place} left out: IoU {scores[place]:.3f}", flush=True)
    print(f"mean of CamVid's {len(found)}: {np.mean(found):.3f}")


def learn_twice(task: SkyTask, places: Sequence[str], asked: SkyLeftOut) -> dict[str, float]:
    """Train without places by labels, then by evidence that this network labels too; returns the IoU of each place."""
    first, second = asked.out / places[0] / "labels", asked.out / places[0] / "evidence"
    train(task, first, asked.how, on_step=tell)
    layers = read_run(first)
    seen = [sample for sample in read_evidence(asked.data, average([layers])) if sample.place not in places]
    taught = SkyTask([*task.samples, *seen], task.judged, start=first)
    return train(taught, second, replace(asked.how, steps=asked.taught_steps), on_step=tell)


def left_out(samples: Sequence[SkySample]) -> Iterator[tuple[SkyTask, tuple[str, ...]]]:
    """Give for each recording the training without it, and which places are judged.

    Raises DataError where nothing else is there to learn from.
    """
    there = {sample.place for sample in samples}
    for pair in LEFT_OUT:
        others = [sample for sample in samples if sample.place not in pair]
        if not others or pair[0] not in there:
            raise DataError(f"sky: samples of {', '.join(sorted(there)) or 'no place'}: needs {pair[0]} and others")
        places = tuple(place for place in pair if place in there)
        yield SkyTask(others, [sample for sample in samples if sample.place in places]), places


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
