"""Where a step runs: plain torch is what gradients, GPUs and exporters need; CPUs have faster kernels."""

import torch
from torch import Tensor


def on_cpu(tensor: Tensor) -> bool:
    """Tell whether a kernel can take a tensor: it is on the CPU, and no exporter is writing the network down."""
    return tensor.device.type == "cpu" and not is_traced()


def without_gradient(tensor: Tensor) -> bool:
    """Tell whether a kernel that has no backward pass can take a tensor."""
    return on_cpu(tensor) and not torch.is_grad_enabled()


def is_traced() -> bool:
    """Tell whether torch is writing down the network for export: then only plain torch will do."""
    return bool(torch.onnx.is_in_onnx_export() or torch.compiler.is_compiling())
