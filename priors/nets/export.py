"""ONNX files of networks, and onnxruntime to run the stereo ones (graphs.py runs the others).

A stereo network's file holds one image size (rounded up to multiples of 32) and one disparity range: the volumes'
shapes follow from them. `priors build --stereo.weights FILE.onnx` runs it on images that are no larger;
`--stereo.runtime onnx` with ordinary weights makes the graphs it needs in memory. `priors export --to onnx` writes
files of all networks (priors/export/networks.py).
"""

import json
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.errors import DataError
from priors.nets.graphs import open_session, write_down
from priors.nets.onnx_volume import portable
from priors.nets.runtime import Ready

OUTPUTS = ("disparity_px", "sigma_px", "doubt")
KEPT = 2
"""Graphs in memory: a drive has one image size and one or two disparity ranges."""

Floats = npt.NDArray[np.float32]


class _Flat(nn.Module):
    """The network with tensors for results and the disparity range fixed."""

    def __init__(self, net: nn.Module, largest_px: int) -> None:
        super().__init__()
        self.net, self.largest_px = net, largest_px

    def forward(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        out = self.net(left, right, self.largest_px)
        return out.disparity_px, out.sigma_px, out.doubt


def to_onnx(ready: Ready, size: tuple[int, int], largest_px: int) -> bytes:
    """Turn a stereo network (made ready for onnx) into a graph.

    Args:
        ready: network and header; the header goes into the file.
        size: (height, width) of the inputs left and right (1, 3, height, width), float32 in [0, 1].
        largest_px: disparities searched, a multiple of 32.

    Returns:
        The file's bytes; outputs disparity_px, sigma_px and doubt (1, height, width).
    """
    example = torch.rand(2, 1, 3, *size)
    net = _Flat(portable(ready.net), largest_px)
    about = {**ready.about, "largest_px": largest_px}
    return write_down(net, (example[0], example[1]), ("left", "right"), OUTPUTS, about)


class Graph:
    """A stereo network in onnxruntime; threads share it."""

    def __init__(self, model: bytes | Path) -> None:
        try:
            self.session = open_session(model)
            self.about: dict[str, Any] = json.loads(self.session.get_modelmeta().custom_metadata_map["roadprior"])
            _, _, *size = self.session.get_inputs()[0].shape
            self.size = (int(size[0]), int(size[1]))
        except DataError:
            raise
        except Exception as error:  # onnxruntime has an exception of its own for every fault
            raise DataError(
                f"{model if isinstance(model, Path) else 'graph'}: no stereo network of ours: {error}"
            ) from error
        self.lock = threading.Lock()

    def __call__(self, left: Tensor, right: Tensor) -> tuple[Floats, Floats, Floats]:
        """Run on images (1, 3, h, w) no larger than the graph's; returns disparity, sigma (px), doubt, each (h, w)."""
        height, width = left.shape[-2:]
        extra = (0, self.size[1] - width, 0, self.size[0] - height)
        if min(extra) < 0:
            raise DataError(
                f"the ONNX file is for images up to {self.size[1]}x{self.size[0]}, this one is {width}x{height}: "
                "export it for this size"
            )
        feeds = {
            name: np.ascontiguousarray(F.pad(image, extra, mode="replicate").numpy())
            for name, image in (("left", left), ("right", right))
        }
        with self.lock:
            disparity_px, sigma_px, doubt = (map_[0, :height, :width] for map_ in self.session.run(OUTPUTS, feeds))
        return disparity_px, sigma_px, doubt


class Graphs:
    """The graphs of one network, made when a new image size or range comes, the last few kept."""

    def __init__(self, ready: Ready) -> None:
        self.ready = ready
        self.graphs: OrderedDict[tuple[int, int, int], Graph] = OrderedDict()
        self.lock = threading.Lock()

    def __call__(self, left: Tensor, right: Tensor, largest_px: int) -> tuple[Floats, Floats, Floats]:
        """Run on a pair (1, 3, h, w); returns disparity, sigma (px) and doubt, each (h, w)."""
        height, width = (-(-int(side) // 32) * 32 for side in left.shape[-2:])
        with self.lock:
            key = (height, width, largest_px)
            if key not in self.graphs:
                self.graphs[key] = Graph(to_onnx(self.ready, (height, width), largest_px))
                while len(self.graphs) > KEPT:
                    self.graphs.popitem(last=False)
            self.graphs.move_to_end(key)
            graph = self.graphs[key]
        return graph(left, right)
