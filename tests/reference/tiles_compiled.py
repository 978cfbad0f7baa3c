"""Compiles a field's networks for a CPU with matrix tiles, on any x86 CPU, and runs nothing; prints what is in them.

Runs in a process of its own: what numba compiles for is decided when it loads.
"""

import os

os.environ |= {"NUMBA_CPU_NAME": "sapphirerapids", "NUMBA_CPU_FEATURES": "+amx-tile,+amx-bf16,+avx512bf16"}

import numpy as np
from numba import typeof

from priors.machine import cpu

cpu.mode = lambda: "amx"  # what follows asks it as it is imported

from nerf.kernels.cpu import perceptron  # noqa: E402

words, numbers = np.zeros(512, np.int32), np.zeros(256, np.float32)
net = perceptron.Net(4, *[words] * 5)
inputs = perceptron.Inputs(words.reshape(8, 64), words, words)
totals = perceptron.Totals(*[numbers.reshape(1, 256)] * 5)
ends = 0, 64
calls = {
    "forward": (net, inputs, 0.02, numbers, numbers, *ends),
    "backward": (net, net, inputs, 0.02, (numbers, numbers), words.reshape(8, 64), totals, 64, 0, 1),
}
for name, arguments in calls.items():
    function = getattr(perceptron, name)
    signature = tuple(typeof(argument) for argument in arguments)
    function.compile(signature)
    code = function.inspect_asm(signature)
    print(name, *(one for one in ("ldtilecfg", "tdpbf16ps", "vcvtne2ps2bf16", "tilerelease") if one in code))
