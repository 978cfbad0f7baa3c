"""Tensors and kernels: where a step runs, what kernels see of a tensor, maps side by side."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

# numpy has no bfloat16: kernels read numbers as the unsigned integers that store them. They know no float16.
STORED = {torch.bfloat16: (torch.int16, np.uint16), torch.float32: (torch.int32, np.uint32)}


def as_bits(tensor: Tensor) -> npt.NDArray[Any]:
    """View a dense bfloat16 or float32 tensor as uint16 or uint32, sharing its memory; see kernels/floats.py.

    Raises TypeError for numbers of another type: their bits would be taken for other numbers.
    """
    if tensor.dtype not in STORED:
        raise TypeError(f"expected bfloat16 or float32 numbers, found {tensor.dtype}")
    signed, unsigned = STORED[tensor.dtype]
    return tensor.detach().contiguous().view(signed).numpy().view(unsigned)


def rows_of_bits(tensor: Tensor) -> npt.NDArray[Any]:
    """View (b, h, ...) as (b * h, ...) in bits."""
    return as_bits(tensor.contiguous().flatten(0, 1))


def on_cpu(tensor: Tensor) -> bool:
    """Tell whether a kernel can take a tensor: it is on the CPU, and no exporter is writing the network down."""
    return tensor.device.type == "cpu" and not is_traced()


def without_gradient(tensor: Tensor) -> bool:
    """Tell whether a kernel that has no backward pass can take a tensor."""
    return on_cpu(tensor) and not torch.is_grad_enabled()


def is_traced() -> bool:
    """Tell whether torch is writing down the network for export: then only plain torch will do."""
    return bool(torch.onnx.is_in_onnx_export() or torch.compiler.is_compiling())


def join(*maps: Tensor) -> Tensor:
    """Join maps (b, c, h, w) of one type to (b, sum of c, h, w); pixels of a map of half the size are repeated.

    All should be channels-last: torch transposes everything otherwise.
    """
    width = max(map_.shape[3] for map_ in maps)
    same = [map_ if map_.shape[3] == width else F.interpolate(map_, scale_factor=2.0) for map_ in maps]
    return torch.cat(same, dim=1)
