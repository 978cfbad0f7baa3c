"""What packing costs: cfnet-s on a pack's held-back crops, and on the same before their images and labels were packed.

python tests/bench/bench_crops.py gpu-crops --street samples --real ../shared/data
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from priors.learn import moment_file
from priors.learn.crop_pack import HELD_BACK
from priors.learn.crop_packing import window_of
from priors.learn.moment import Moment
from priors.learn.real_moments import candidates
from priors.learn.stereo import StereoTask
from priors.learn.stereo_data import even
from priors.nets import runtime, weights


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack", type=Path, help="folder of priors train pack-crops")
    parser.add_argument("--street", type=Path, default=Path("samples"))
    parser.add_argument("--real", type=Path, default=Path("../shared/data"))
    options = parser.parse_args()
    net = runtime.create("cfnet", "s")
    weights.take(net, weights.find("cfnet", "s"))
    before, after = [], []
    for one in candidates(options.real, options.street)[1]:
        path = options.pack / HELD_BACK / f"{one.source}_{one.name}.npz"
        if path.exists() and (made := window_of(one.make(), middle=True)).right is not None:
            before.append(made)
            after.append(moment_file.read(path))
    decibels = [psnr(one, other) for one, other in zip(before, after, strict=True)]
    print(f"{len(before)} crops, left images: {np.mean(decibels):.1f} dB")
    labels = [replace(new, left=old.left, right=old.right) for new, old in zip(after, before, strict=True)]
    for name, moments in (("as they are", before), ("labels packed", labels), ("all packed", after)):
        pairs = [even(one.pair()) for one in moments]
        found = StereoTask(net.eval(), lambda rng: before[0].pair(), pairs).validate(net)
        print(f"{name:14}", ", ".join(f"{key} {value:.4f}" for key, value in found.items()))


def psnr(one: Moment, other: Moment) -> float:
    """Return how alike two left images are, dB; a grey one is repeated."""
    left = one.left if one.left.ndim == 3 else np.repeat(one.left[..., None], 3, axis=2)
    return float(-10 * np.log10(np.mean((left.astype(np.float64) - other.left) ** 2) / 255**2))


if __name__ == "__main__":
    main()
