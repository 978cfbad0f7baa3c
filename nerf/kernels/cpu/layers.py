"""Layers of the small networks as the products take them: cut into tiles, and their gradients put together again."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.products import OPERAND
from priors.machine.compiled import compiled

Numbers = npt.NDArray[np.float32]
Bits = npt.NDArray[np.int32]
Operands = npt.NDArray[np.int32] | npt.NDArray[np.float32]
"""Tiles as the left side of a product: words of two bfloat16, or two float32 for each."""
PAIRED = OPERAND is np.int32


class Net(NamedTuple):
    """Weights as tiles: (out / 16, in / 32) of 16 x 16 pairs, flat, padded with zeros; bfloat16 or rounded to it."""

    tiles: int
    """Rows of tiles of a hidden layer: its width / 16."""
    density0: Operands
    density1: Operands
    colour0: Operands
    colour1: Operands
    colour2: Operands


class Totals(NamedTuple):
    """Gradients of the weights of (parts,) of the samples: tiles (out / 16, in / 16) of 16 x 16 float32, flat."""

    density0: Numbers
    density1: Numbers
    colour0: Numbers
    colour1: Numbers
    colour2: Numbers


def padded(rows: int, columns: int) -> tuple[int, int]:
    """Return the size of a layer with whole tiles, of 16 rows and 32 columns."""
    return -(-rows // 16) * 16, -(-columns // 32) * 32


@compiled
def _rounded(pattern):  # type: ignore[no-untyped-def]
    """Return the bits of a float32 rounded to bfloat16 (nearest, ties to even), in the low half; NaN stays one."""
    if pattern & np.int64(0x7FFFFFFF) > np.int64(0x7F800000):
        return np.int64(0x7FC0)
    return ((pattern + np.int64(0x7FFF) + ((pattern >> np.int64(16)) & np.int64(1))) >> np.int64(16)) & np.int64(0xFFFF)


@compiled
def cut(layer: Bits, rows: int, columns: int, row_step: int, column_step: int, out: Bits) -> None:
    """Round a layer, rows x columns, to bfloat16 and write its tiles, as a Net has them.

    layer: bits of float32, flat; steps: from a row and from a column to the next, so that a transpose is no copy; out:
    bits of the operands, flat.
    """
    across = (columns + 31) // 32
    out[:] = 0
    for row in range(rows):
        line = row // 16 * across * 256 + row % 16 * 16
        for column in range(columns):
            half = _rounded(np.int64(layer[row * row_step + column * column_step]))
            pair = line + column // 32 * 256 + column % 32 // 2
            if PAIRED:
                shifted = half << np.int64(16) if column % 2 else half
                out[pair] = np.int32(np.int64(out[pair]) | shifted)
            else:
                out[2 * pair + column % 2] = np.int32(half << np.int64(16))


@compiled
def join(total: Numbers, rows: int, columns: int, out: Numbers) -> None:
    """Add up the parts of a gradient, total (parts, tiles), in their order, and write it as its layer lies, flat."""
    across = (columns + 31) // 32 * 2
    whole = total[0]
    for part in range(1, len(total)):
        for i in range(len(whole)):
            whole[i] += total[part, i]
    for row in range(rows):
        for column in range(columns):
            tile = row // 16 * across + column // 16
            out[row * columns + column] = whole[tile * 256 + row % 16 * 16 + column % 16]
