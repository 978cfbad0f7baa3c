"""Which stereo model suits this machine: the most accurate one that is fast enough here.

Time is counted in OpenCV's semi-global matching (SGBM) on the same pair, by the table that priors/nets/speeds.py has.
"""

from typing import Literal

from priors.machine import cpu
from priors.machine.cpu import Mode

Model = Literal["classical", "cfnet"]
BEST: Model = "cfnet"
"""The most accurate network on pairs that nothing was trained on (priors/weights/cfnet-s.md)."""
MOST: dict[Mode, float] = {"amx": 2.1, "avx512_bf16": 3.1}
OTHERS = 5.0
"""Times of SGBM that a network may take on CPUs of a mode."""


def choose(size: str = "s") -> Model:
    """Return the model that suits this machine."""
    import torch

    from priors.nets import int8, speeds  # keeps PyTorch out of --help

    if torch.cuda.is_available():
        return BEST
    mode = cpu.mode()
    times = speeds.times(mode, BEST, integers=int8.runs(BEST, size))
    if times is None:  # nobody measured it: what its name promises
        return BEST if mode in speeds.FAST_BF16 else "classical"
    return BEST if size == "s" and times <= MOST.get(mode, OTHERS) else "classical"
