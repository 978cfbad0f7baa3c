"""Post-training quantisation of a stereo network to 8-bit integers: measures the ranges of its convolutions' inputs.

    python -m priors.learn.int8_ranges --net cfnet --data KITTI/odometry/sequences/06 street/ --every 10

It writes FILE.int8.json beside the weights: in which range the inputs of the large 2D convolutions lie, on drives that
trained the network.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from eval.files import write_bytes
from priors.drives import open_drive
from priors.errors import DataError
from priors.nets import weights
from priors.nets.int8 import ActivationRange, beside, candidates
from priors.nets.runtime import as_input, open_net

TAIL = 1e-5
"""Share of the values that may lie beyond a range, on either side."""
SAMPLED = 2_000_000
"""Values of an input that are looked at, about: torch.quantile takes no more than 16 million."""
LARGEST_PX = 192
"""Disparities searched."""


@contextmanager
def watched(net: nn.Module) -> Iterator[dict[str, ActivationRange]]:
    """Widen the ranges of the candidates' inputs by what runs through a plain network inside."""
    ranges: dict[str, ActivationRange] = {}

    def widen(name: str) -> Any:
        def hook(layer: nn.Module, inputs: tuple[Tensor, ...]) -> None:
            some = inputs[0].float().flatten()[:: max(1, inputs[0].numel() // SAMPLED)]
            low, high = (float(torch.quantile(some, share)) for share in (TAIL, 1 - TAIL))
            before = ranges.get(name, ActivationRange(0, 0))
            ranges[name] = ActivationRange(min(before.low, low), max(before.high, high))

        return hook

    hooks = [layer.register_forward_pre_hook(widen(name)) for name, layer in candidates(net).items()]
    try:
        yield ranges
    finally:
        for hook in hooks:
            hook.remove()


def measure(
    net: str, size: str, pairs: Iterable[tuple[Tensor, Tensor]], file: Path | None = None
) -> dict[str, ActivationRange]:
    """Return the ranges on pairs (1, 3, h, w) in [0, 1]."""
    ready = open_net(net, size, "onnx", file)  # plain, float32
    with watched(ready.net) as ranges:
        for left, right in pairs:
            ready(left, right, largest_px=LARGEST_PX)
    return ranges


def main(arguments: list[str] | None = None) -> None:
    """Measure and write ranges; takes the command line's arguments."""
    import tyro

    tyro.cli(calibrate, args=arguments, description=__doc__)


def calibrate(
    net: str,
    data: list[Path],
    every: int = 10,
    size: str = "s",
    weights_file: Path | None = None,
) -> None:
    """Write the ranges of a stereo network's inputs on drives' pairs.

    Args:
        net: cfnet or pcwnet.
        data: drives with pairs; none that is for testing.
        every: take every so many frames.
        size: s, m or l.
        weights_file: your own weights; default: what ships.
    """
    if every < 1:
        raise DataError(f"--every is {every}, expected 1 or more")
    path = weights.find(net, size, weights_file)
    drives = [open_drive(folder) for folder in data]
    frames = [drive[k] for drive in drives for k in range(0, len(drive), every)]
    pairs = ((as_input(frame.image()), as_input(frame.other())) for frame in frames)
    ranges = measure(net, size, pairs, weights_file)
    text = {
        "weights": weights.digest(path),
        "data": [drive.name for drive in drives],
        "pairs": len(frames),
        "ranges": {name: [round(span.low, 5), round(span.high, 5)] for name, span in ranges.items()},
    }
    write_bytes(beside(path), (json.dumps(text) + "\n").encode())
    print(f"wrote {beside(path)}: {len(ranges)} convolutions, {len(frames)} pairs")


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
