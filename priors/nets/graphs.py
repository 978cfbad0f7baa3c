"""ONNX graphs of networks: exported once for each size of input, run by onnxruntime."""

import json
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from priors.nets import weights
from priors.nets.bts import MonoOut
from priors.nets.mffnet import Completed
from priors.nets.runtime import Ready, open_net

OPSET = 17
KEPT = 4
"""Graphs of a network in memory: a drive has one image size, and what is cropped off it has a few."""


@dataclass(frozen=True, slots=True)
class Form:
    """What a network of one image takes and gives, by the names that a graph has for it."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    """Fields of the network's result."""
    result: Callable[..., Any]
    """Makes the network's result of its outputs."""
    examples: Callable[[int, int], tuple[Tensor, ...]]
    """Inputs for a height and a width."""


def _mono_example(height: int, width: int) -> tuple[Tensor, ...]:
    K = torch.tensor([[[700.0, 0, width / 2], [0, 700, height / 2], [0, 0, 1]]])
    return torch.rand(1, 3, height, width), K


def _completion_example(height: int, width: int) -> tuple[Tensor, ...]:
    maps = (1, height, width)
    return torch.rand(1, 3, height, width), 1 + torch.rand(maps), torch.rand(maps), torch.rand(maps).sub(0.5).relu()


FORMS = {
    "bts": Form(("image", "K"), ("depth_m", "sky_logit", "log_scale", "coarse_m"), MonoOut, _mono_example),
    "mffnet": Form(
        ("image", "fill_m", "certain", "sparse_m"),
        ("depth_m", "log_scale"),
        lambda depth_m, log_scale: Completed(depth_m, log_scale, ()),
        _completion_example,
    ),
}
"""Stereo networks have an extra, the range of disparities: see export.py."""


class _Flat(nn.Module):
    """The network with tensors for results."""

    def __init__(self, net: nn.Module, outputs: Sequence[str]) -> None:
        super().__init__()
        self.net, self.outputs = net, outputs

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        out = self.net(*inputs)
        return tuple(getattr(out, name) for name in self.outputs)


def write_down(
    net: nn.Module, examples: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str], about: dict[str, Any]
) -> bytes:
    """Turn a module from tensors to tensors into an ONNX file's bytes, for inputs of the examples' sizes.

    `about` goes into the file.
    """
    import onnx

    with torch.inference_mode(), warnings.catch_warnings(), TemporaryDirectory() as folder:
        path = Path(folder) / "graph.onnx"
        warnings.simplefilter("ignore")  # of shapes that become constants: that is what is wanted
        torch.onnx.export(
            net.eval(),
            examples,
            path,
            input_names=list(inputs),
            output_names=list(outputs),
            opset_version=OPSET,
            dynamo=False,  # the other exporter needs one more package
        )
        model = onnx.load(path)
    onnx.helper.set_model_props(model, {"roadprior": json.dumps(about)})
    return bytes(model.SerializeToString())


def open_session(model: bytes | Path) -> Any:
    """Open a graph in onnxruntime, with as many threads as torch has."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 3
    source = str(model) if isinstance(model, Path) else model
    return onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])


def to_onnx(ready: Ready, name: str, examples: tuple[Tensor, ...]) -> bytes:
    """Turn bts or mffnet (made ready for onnx) into a graph for inputs of the examples' sizes: the file's bytes."""
    form = FORMS[name]
    return write_down(_Flat(ready.net, form.outputs), examples, form.inputs, form.outputs, ready.about)


class Portable:
    """A network of one image in onnxruntime, called as its Ready is; a graph is made when a new size comes."""

    runtime = "onnx"

    def __init__(self, ready: Ready, name: str) -> None:
        self.ready, self.name, self.about = ready, name, ready.about
        self.sessions: OrderedDict[tuple[torch.Size, ...], Any] = OrderedDict()
        self.lock = threading.Lock()

    def __call__(self, *inputs: Tensor) -> Any:
        """Run on what the network takes, float32; returns what it gives. Threads share it, one runs at a time."""
        form = FORMS[self.name]
        key = tuple(value.shape for value in inputs)
        with self.lock:
            if key not in self.sessions:
                self.sessions[key] = open_session(to_onnx(self.ready, self.name, inputs))
                while len(self.sessions) > KEPT:
                    self.sessions.popitem(last=False)
            self.sessions.move_to_end(key)
            feeds = {name: np.ascontiguousarray(value.numpy()) for name, value in zip(form.inputs, inputs, strict=True)}
            outputs = self.sessions[key].run(form.outputs, feeds)
        return form.result(*map(torch.from_numpy, outputs))


def open_portable(name: str, size: str, file: Path | None = None) -> Portable:
    """Load bts or mffnet for onnxruntime, once a process for each file."""
    path = weights.find(name, size, file)
    return _open(name, size, path, weights.digest(path))


@lru_cache(maxsize=16)
def _open(name: str, size: str, path: Path, _digest: str) -> Portable:
    return Portable(open_net(name, size, "onnx", path), name)
