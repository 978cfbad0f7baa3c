"""Fit of weights/classical.json: which of the surfaces around a pixel the classical stereo chooses where it is unsure.

    python -m priors.learn.fit_classical --street samples/ --real ../shared/data

It learns from the pairs that `priors train surfaces` takes (surface_fit.py), and says first what it is worth on pairs
that it has not seen. A street weighs as much as a real pair.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from eval.files import write_bytes
from priors.learn import surface_fit
from priors.learn.stereo_data import Folders
from priors.learn.stereo_pair import StereoPair
from priors.methods import _stereo_classical as classical
from priors.nets import surface_choice
from priors.nets.surface_choice import Maps

SHARES = dict.fromkeys(surface_fit.SHARES, 1.0)
"""What a pair of each source weighs. With less, streets lose RMSE; KITTI 2015 would gain some more."""


@dataclass(frozen=True)
class ClassicalFit:
    """Fit the classical method's choice among surfaces."""

    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Holds kitti_stereo2015 and kitti_raw_train."""
    cache: Path | None = None
    """Where prepared real data is kept; default: `real` beside the samples."""
    out: Path = classical.CHOICE
    """Where the rule goes."""


def main(arguments: list[str] | None = None) -> None:
    """Fit, print what it is worth on pairs left out, and write; takes the command line's arguments."""
    asked = tyro.cli(ClassicalFit, args=arguments, description=__doc__)
    paths = surface_fit.find_pairs(Folders(asked.street, asked.real, asked.cache))
    pixels = surface_fit.collect(look, paths, SHARES, wide=True)
    for line in surface_fit.cross_validate(pixels):
        print(line, flush=True)
    held = {surface_choice.ENTRY: surface_fit.fit(pixels).record()}
    write_bytes(asked.out, (json.dumps(held) + "\n").encode())


def look(pair: StereoPair) -> Maps:
    """Return what the classical method says of a pair before it chooses."""
    return classical.smooth(pair.left, pair.right)


if __name__ == "__main__":
    main()
