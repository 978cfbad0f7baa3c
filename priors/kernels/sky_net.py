"""The sky mask's network without PyTorch: its layers over planes (channels, height, width), and their order.

`priors/learn/sky_net.py` is the slow twin, and what training learns. To load PyTorch takes a second, a mask 10 ms.
"""

from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from priors.machine import threads
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

Floats = npt.NDArray[np.float32]
Layer: TypeAlias = "tuple[Floats, Floats]"
"""Weights (inputs, outputs), or (channels, kernel, kernel) of a depthwise one, and bias (outputs)."""
Layers: TypeAlias = "dict[str, Layer]"
STRIDES = (1, 2, 1, 2, 1, 2, 1, 1)
"""Stride of each block of the encoder."""
TAPPED = (0, 2, 4, 7)
"""Blocks whose features the way up takes: at 1/2, 1/4, 1/8 and 1/16."""
LARGEST = np.float32(6)
"""Activations lie in 0 .. 6 (ReLU6)."""
STRETCH = 512
"""Pixels mixed at a time: their line stays in the fastest cache."""


def forward(colour: Floats, layers: Layers) -> FloatMap:
    """Run the network on colours (height, width, 3) in [0, 1]: logits of sky (ceil(height / 2), ceil(width / 2))."""
    image = np.ascontiguousarray(colour.transpose(2, 0, 1)) * np.float32(255 / 128) - np.float32(127 / 128)
    features = stem(image, layers["stem"])
    levels: list[Floats] = []
    for number, stride in enumerate(STRIDES):
        features = inverted(features, f"blocks.{number}", layers, stride)
        if number in TAPPED:
            levels.append(mix(features, layers[f"side.{len(levels)}"], clipped=True))
    deep = levels.pop()
    weights, bias = layers["whole"]
    deep = deep + (deep.mean(axis=(1, 2)) @ weights + bias)[:, None, None]
    for number in range(2):
        deep = inverted(deep, f"look.{number}", layers)
    for number, level in reversed(list(enumerate(levels))):
        up = enlarge(mix(deep, layers[f"lower.{number}"], clipped=True), level.shape[1], level.shape[2])
        deep = inverted(level + up, f"mend.{number}", layers)
    return mix(deep, layers["last"])[0]


def inverted(values: Floats, name: str, layers: Layers, stride: int = 1) -> Floats:
    """Run an inverted residual block: widen, look around channel by channel, narrow."""
    wide = mix(values, layers[f"{name}.widen"], clipped=True) if f"{name}.widen" in layers else values
    narrow = mix(look(wide, layers[f"{name}.look"], stride), layers[f"{name}.narrow"])
    return narrow + values if stride == 1 and narrow.shape == values.shape else narrow


def mix(values: Floats, layer: Layer, clipped: bool = False) -> Floats:
    """Mix channels pixel by pixel: (inputs, height, width) to (outputs, height, width), cut to 0 .. 6 if asked."""
    table, count = np.vstack(layer), values.shape[1] * values.shape[2]
    flat, out = values.reshape(len(values), count), np.empty((table.shape[1], count), np.float32)
    block = -(-threads.worth(0.05 * table.size) // STRETCH) * STRETCH
    threads.over(count, lambda first, last: _mix(flat, table, clipped, out, first, last), block)
    return out.reshape(-1, *values.shape[1:])


@compiled(fastmath=FAST, error_model="numpy")
def _mix(values: Floats, table: Floats, clipped: bool, out: Floats, first: int, last: int) -> None:
    weights, bias = table[:-1], table[-1]
    inputs, outputs = weights.shape
    threes = inputs // 3 * 3
    spare = np.empty(STRETCH, np.float32)
    for start in range(first, last, STRETCH):
        end = min(last, start + STRETCH)
        for j in range(0, outputs, 2):
            # Two outputs and three inputs at a time: more pointers, and LLVM would not vectorise.
            k = min(j + 1, outputs - 1)
            line, other = out[j, start:end], spare[: end - start] if k == j else out[k, start:end]
            line[:] = bias[j]
            other[:] = bias[k]
            for i in range(0, threes, 3):
                a, b, c = weights[i, j], weights[i + 1, j], weights[i + 2, j]
                d, e, f = weights[i, k], weights[i + 1, k], weights[i + 2, k]
                one, two, three = values[i, start:end], values[i + 1, start:end], values[i + 2, start:end]
                for n in range(end - start):
                    x, y, z = one[n], two[n], three[n]
                    line[n] += a * x + b * y + c * z
                    other[n] += d * x + e * y + f * z
            for i in range(threes, inputs):
                a, d, one = weights[i, j], weights[i, k], values[i, start:end]
                for n in range(end - start):
                    line[n] += a * one[n]
                    other[n] += d * one[n]
            if clipped:
                for n in range(end - start):
                    line[n] = min(max(line[n], np.float32(0)), LARGEST)
                    other[n] = min(max(other[n], np.float32(0)), LARGEST)


def stem(image: Floats, layer: Layer) -> Floats:
    """Run a dense 3x3 convolution of stride 2 on an image (3, height, width), cut to 0 .. 6."""
    padded = np.pad(image, ((0, 0), (1, 1), (1, 1)))
    rows, columns = -(-image.shape[1] // 2), -(-image.shape[2] // 2)
    views = [padded[:, y : y + 2 * rows - 1 : 2, x : x + 2 * columns - 1 : 2] for y in range(3) for x in range(3)]
    return mix(np.stack(views, axis=1).reshape(-1, rows, columns), layer, clipped=True)


def look(values: Floats, layer: Layer, stride: int) -> Floats:
    """Convolve each channel with its own kernel and cut to 0 .. 6; sizes are divided by the stride, rounded up."""
    weights, bias = layer
    channels, height, width = values.shape
    out = np.empty((channels, -(-height // stride), -(-width // stride)), np.float32)
    block = threads.worth(0.1 * out[0].size * weights[0].size)
    threads.over(channels, lambda first, last: _look(values, weights, bias, out, first, last), block)
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _look(values: Floats, weights: Floats, bias: Floats, out: Floats, first: int, last: int) -> None:
    _, height, width = values.shape
    stride = 1 if out.shape == values.shape else 2
    side = weights.shape[1]
    margin = side // 2
    rows, columns = out.shape[1], out.shape[2]
    padded = np.zeros((height + 2 * margin, width + 2 * margin + 1), np.float32)
    line = np.empty(padded.shape[1], np.float32)
    for channel in range(first, last):
        for y in range(height):
            for x in range(width):
                padded[y + margin, x + margin] = values[channel, y, x]
        for y in range(rows):
            wide = width if stride == 1 else 2 * columns - 1
            for x in range(wide):
                line[x] = bias[channel]
            for i in range(side):
                row = padded[y * stride + i]
                for j in range(side):
                    weight = weights[channel, i, j]
                    part = row[j : j + wide]
                    for x in range(wide):
                        line[x] += weight * part[x]
            for x in range(columns):
                out[channel, y, x] = min(max(line[x * stride], np.float32(0)), LARGEST)


def enlarge(values: Floats, height: int, width: int) -> Floats:
    """Interpolate planes bilinearly to a size."""
    planes = [cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR) for plane in values]
    return np.stack(planes).astype(np.float32, copy=False)
