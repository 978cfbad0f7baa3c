"""Tensors as kernels see them: numpy has no bfloat16, so numbers go over as the unsigned integers that store them."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

STORED = {2: (torch.int16, np.uint16), 4: (torch.int32, np.uint32)}


def as_bits(tensor: Tensor) -> npt.NDArray[Any]:
    """View a dense bfloat16 or float32 tensor as uint16 or uint32, sharing its memory; see kernels/floats.py."""
    signed, unsigned = STORED[tensor.itemsize]
    return tensor.detach().contiguous().view(signed).numpy().view(unsigned)


def rows_of_bits(tensor: Tensor) -> npt.NDArray[Any]:
    """View (b, h, ...) as (b * h, ...) in bits."""
    return as_bits(tensor.contiguous().flatten(0, 1))
