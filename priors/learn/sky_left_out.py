"""How well the sky mask does on recordings that it has not seen: each of CamVid's is left out in turn.

    python -m priors.learn.sky_left_out --data ../shared/data --streets street21 street22

Both rules are fitted as fit_sky.py does, on everything but one recording, and scored on all labelled frames of that
one, of whatever split. CamVid's validation split alone would flatter: its recording is in the training split too.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import tyro

from priors import sky
from priors.errors import DataError
from priors.learn.fit_sky import SkyFit, first_blocks, fit_layers, held_out_blocks, read_samples
from priors.learn.sky_labels import SKY, UNKNOWN, SkySample, read_camvid

RECORDINGS = ("0001", "0006", "0016")
"""CamVid's recordings with labels at hand: 0001TP (dusk), 0006R0 and 0016E5."""


def main(arguments: list[str] | None = None) -> None:
    """Print the IoU of every recording left out and the mean; takes the command line's arguments."""
    fit = tyro.cli(SkyFit, args=arguments, description=__doc__)
    samples = read_samples(fit)
    judged = [*read_camvid(fit.data / "camvid", "train"), *read_camvid(fit.data / "camvid", "val")]
    found = []
    for recording, rules in left_out(samples, fit.seed):
        found.append(score([sample for sample in judged if sample.place == recording], rules))
        print(f"CamVid {recording} left out: IoU {found[-1]:.3f}", flush=True)
    print(f"mean of {len(found)}: {np.mean(found):.3f}")


def left_out(samples: Sequence[SkySample], seed: int) -> Iterator[tuple[str, tuple[sky.Layers, sky.Layers]]]:
    """Give each recording and the rules fitted without it; DataError where fewer than two places are there."""
    everywhere = sorted({sample.place for sample in samples})
    if len(everywhere) < 3:
        raise DataError(
            f"sky: samples of {', '.join(everywhere) or 'no place'}: two others are needed beside one left out"
        )
    for recording in RECORDINGS:
        places = [place for place in everywhere if place != recording]
        first = first_blocks(samples, places, seed)
        second = held_out_blocks(samples, places, first, seed)
        yield recording, (fit_layers(*first, seed), fit_layers(second, first[1], seed))


def score(samples: Sequence[SkySample], rules: tuple[sky.Layers, sky.Layers]) -> float:
    """Return the intersection over union of what rules find and what is sky, over all known pixels of samples."""
    both = either = 0
    for sample in samples:
        found, known, true = sky.find_sky(sample.image, rules), sample.label != UNKNOWN, sample.label == SKY
        both += int(np.count_nonzero(found & true))
        either += int(np.count_nonzero((found | true) & known))
    return both / max(1, either)


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
