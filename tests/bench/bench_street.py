"""Time the street: CPU seconds for a world, a stereo pair with truth and a sweep, at several sizes.

python tests/bench/bench_street.py [--seed 7] [--repeat 3]
"""

import argparse
import statistics
import time

from priors.street import rig
from priors.street.street import Street

SIZES = ((96, 320), (188, 620), (375, 1242))


def main() -> None:
    """Print medians; CPU time, because the wall clock of a shared machine says little."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    start = time.process_time()
    street = Street(args.seed)
    print(f"world of {len(street.world.still)} triangles: {time.process_time() - start:.2f} s")
    taken: dict[str, list[float]] = {}
    for turn in range(args.repeat):
        for size in SIZES:
            start = time.process_time()
            street.pair(street.T_world_cam(0.1 * turn), rig.camera(size), 0.1 * turn)
            taken.setdefault(f"pair {size[1]}x{size[0]}", []).append(time.process_time() - start)
        start = time.process_time()
        street.sweep(0.1 * turn)
        taken.setdefault("sweep", []).append(time.process_time() - start)
    for name, seconds in taken.items():
        print(f"{name:16s} {statistics.median(seconds):.3f} s")


if __name__ == "__main__":
    main()
