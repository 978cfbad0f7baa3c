"""IoU of the sky mask on CamVid's validation split, outlined KITTI frames and any street given; time at KITTI's size.

python tests/bench/bench_sky.py --data ../shared/data [--street DIR]
"""

import argparse
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from priors.learn.sky_held_back import read_held_back
from priors.learn.sky_labels import SKY, UNKNOWN, SkySample, read_camvid, read_kitti, read_street
from priors.sky import sky_mask


def score(name: str, samples: Iterable[SkySample]) -> None:
    """Print the pooled IoU, and missed and false sky as shares of the union; colour and grey."""
    for kind in ("colour", "grey"):
        both = missed = false = 0
        for sample in samples:
            image = sample.image
            if kind == "grey" and image.ndim == 3:
                image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            found, known, true = sky_mask(image), sample.label != UNKNOWN, sample.label == SKY
            both += np.count_nonzero(found & true)
            missed += np.count_nonzero(true & ~found)
            false += np.count_nonzero(found & ~true & known)
        union = max(1, both + missed + false)
        print(f"{name:24} {kind:6} IoU {both / union:.3f}  missed {missed / union:.3f}  false {false / union:.3f}")


def main() -> None:
    """Score and time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--street", type=Path)
    options = parser.parse_args()
    score("camvid val", list(read_camvid(options.data / "camvid", "val")))
    score("kitti 2015, held back", list(read_held_back(options.data)))
    score("kitti, outlined (fitted)", list(read_kitti(options.data)))
    if options.street:
        score(f"street {options.street.name}", list(read_street(options.street, 1)))
    image = next(sample.image for sample in read_kitti(options.data) if sample.image.ndim == 3)
    image = cv2.resize(image, (1242, 375))
    seconds = []
    for _ in range(30):
        start = time.perf_counter()
        sky_mask(image)
        seconds.append(time.perf_counter() - start)
    print(f"1242x375: median {1e3 * np.median(seconds):.1f} ms, fastest {1e3 * min(seconds):.1f} ms")


if __name__ == "__main__":
    main()
