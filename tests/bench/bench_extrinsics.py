"""What a drive shows of its extrinsics: as it is, turned on purpose, and in parts.

python tests/bench/bench_extrinsics.py street/                       as it is
    python tests/bench/bench_extrinsics.py street/ --turn 0.3 0 0        turned first: pitch, yaw, roll, degrees
python tests/bench/bench_extrinsics.py street/ --delay-ms 20
python tests/bench/bench_extrinsics.py DATA/kitti_stereo2015 --parts 4
"""

import argparse
from pathlib import Path

import numpy as np

from priors.drives import open_drive
from priors.extrinsics.correction import Correction
from priors.extrinsics.measure import FRAMES, measure


def main() -> None:
    """Print a line a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=Path, help="the drive's folder")
    parser.add_argument("--turn", type=float, nargs=3, default=(0.0, 0.0, 0.0), help="degrees, before it is measured")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="by which sweeps are made too late")
    parser.add_argument("--parts", type=int, default=1, help="stretches of the drive, each measured alone")
    parser.add_argument("--frames", type=int, default=FRAMES, help="looked at in each part")
    args = parser.parse_args()
    drive, wrong = open_drive(args.drive), Correction(tuple(args.turn), -0.001 * args.delay_ms)
    for part in np.array_split(np.arange(len(drive)), args.parts):
        places = part[np.linspace(0, len(part) - 1, min(args.frames, len(part))).round().astype(int)]
        frames = [wrong.frame(drive[place]) for place in places.tolist()]
        print(f"{frames[0].id} to {frames[-1].id}: {measure(frames)}", flush=True)


if __name__ == "__main__":
    main()
