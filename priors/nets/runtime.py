"""Runtimes of networks: bf16, fp32, int8, CUDA or onnxruntime, picked from a table; each network is loaded once.

Weights are cast once, memory is channels-last, convolutions are fused with what follows them. What is fastest differs
with the CPU (speeds.py, docs/benchmarks.md). Nothing is measured at run time.
"""

import logging
import threading
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from priors.codecs import as_rgb
from priors.errors import DataError
from priors.machine import cpu
from priors.nets import int8, speeds, weights
from priors.nets.blocks import channels_last, fold
from priors.nets.fused import fuse
from priors.types import Image

Runtime = Literal["bf16", "fp32", "int8", "cuda", "onnx"]
Floating = Literal["bf16", "fp32", "cuda", "onnx"]
Asked = Literal["auto", "bf16", "fp32", "int8", "cuda", "onnx"]

LOG = logging.getLogger(__name__)

_LOADING, _FORWARD = threading.Lock(), threading.Lock()
_loaded: dict[tuple[Any, ...], "Ready"] = {}


def choose(asked: Asked, file: Path | None = None, net: str | None = None, size: str = "s") -> Runtime:
    """Decide 'auto': a file's own runtime, else CUDA where there is one, else what speeds.py's table says of the net.

    Raises DataError where what was asked for is not there.
    """
    is_onnx = file is not None and file.suffix == ".onnx"
    if asked == "auto":
        if is_onnx:
            return "onnx"
        if torch.cuda.is_available():
            return "cuda"
        return speeds.fastest(cpu.mode(), net, integers=int8.runs(net, size, file))
    if is_onnx and asked != "onnx":
        raise DataError(f"{file}: an ONNX file runs with runtime onnx, not {asked}")
    if asked == "int8" and not int8.available():
        raise DataError("runtime int8: this CPU has no VNNI, products would overflow: choose auto")
    if asked == "cuda" and not torch.cuda.is_available():
        raise DataError("runtime cuda: PyTorch sees no CUDA device here: choose auto")
    return asked


def choose_floating(asked: Asked, file: Path | None = None, net: str | None = None) -> Floating:
    """Decide as `choose` does, for networks that do not run on integers."""
    runtime = choose(asked, file, net)
    if runtime == "int8":
        raise DataError("runtime int8: stereo networks alone run on integers: choose auto")
    return runtime


@dataclass(frozen=True, slots=True)
class Ready:
    """A network ready to run; threads share it, one runs at a time on all cores."""

    net: nn.Module
    runtime: Runtime
    about: dict[str, Any]
    """The header of its weights."""

    @property
    def device(self) -> torch.device:
        """Where inputs go."""
        return torch.device("cuda" if self.runtime == "cuda" else "cpu")

    def __call__(self, *inputs: Tensor, **more: Any) -> Any:
        """Run forward without gradients; 4-dimensional inputs go in channels-last."""
        with _FORWARD, torch.inference_mode():
            return self.net(*(self._place(value) for value in inputs), **more)

    def _place(self, value: Tensor) -> Tensor:
        value = value.to(self.device)
        return value.contiguous(memory_format=torch.channels_last) if value.dim() == 4 else value


def make_ready(net: nn.Module, runtime: Runtime, about: dict[str, Any] | None = None) -> Ready:
    """Fold, cast, fuse and lay out a network for a runtime, in place.

    int8 is bf16, where the CPU multiplies that, else fp32, but for the convolutions that int8.mark noted ranges at.
    cuda runs in bf16 where the device has it. onnx keeps plain fp32: priors.nets.export turns that into a graph.
    Folded weights are rounded to bf16 for every runtime, so that all run the same network: half of what bf16 and fp32
    would disagree by comes from the weights.
    """
    fold(net.eval()).requires_grad_(False).to(torch.bfloat16)
    halves = runtime == "bf16" or (runtime == "int8" and cpu.mode() in speeds.FAST_BF16)
    if not halves and not (runtime == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)):
        net.to(torch.float32)
    if runtime == "cuda":
        net.to("cuda")
    if runtime != "onnx":
        channels_last(net)
    if runtime in ("bf16", "fp32", "int8"):
        fuse(net)
    return Ready(net, runtime, about or {})


def open_net(name: str, size: str, runtime: Runtime, file: Path | None = None) -> Ready:
    """Load a network with its weights, once a process for each file and runtime.

    Args:
        name: its module in priors/nets.
        size: s, m or l.
        runtime: from `choose`.
        file: the user's weights; None: what ships.
    """
    path = weights.find(name, size, file)
    key = (name, size, runtime, weights.digest(path))
    with _LOADING:
        if key not in _loaded:
            net = create(name, size)
            trained = weights.load(path)
            weights.fill(net, trained, name, size)
            if runtime == "int8":
                int8.mark(fold(net.eval()), path)
            _loaded[key] = make_ready(net, runtime, trained.about)
            LOG.info("network %s-%s of %s runs as %s", name, size, path, runtime)
        return _loaded[key]


def create(name: str, size: str) -> nn.Module:
    """Make a network with fresh weights: priors/nets/cfnet.py has a class Cfnet, net with its size."""
    net: nn.Module = getattr(import_module(f"priors.nets.{name}"), name.capitalize())(size)
    return net


def as_bytes(image: Image) -> Tensor:
    """Turn an image (h, w, 3) or (h, w) uint8 into (1, 3, h, w) uint8, channels-last; grey is repeated."""
    return torch.from_numpy(np.ascontiguousarray(as_rgb(image))).permute(2, 0, 1)[None]


def as_input(image: Image) -> Tensor:
    """Turn an image (h, w, 3) or (h, w) uint8 into (1, 3, h, w) float32 in [0, 1]; grey is repeated."""
    return as_bytes(image).float() / 255


def as_map(tensor: Tensor) -> npt.NDArray[np.float32]:
    """Turn one map (1, h, w) or (1, 1, h, w) into (h, w) float32."""
    return np.ascontiguousarray(tensor.float().cpu().numpy().reshape(tensor.shape[-2:]))
