"""LPIPS: the distance of two images as a network trained on ImageNet sees them; weights are the user's.

Zhang et al., CVPR 2018, version 0.1 with linear heads. Two backbones, SqueezeNet 1.1 (`squeeze`) and VGG16 (`vgg`),
by their torchvision weights. The networks' figures are not comparable: every figure names its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from eval.protocol import ScoreError, text

if TYPE_CHECKING:
    from torch import Tensor

Layers: TypeAlias = "dict[str, Tensor]"

HOW_TO_GET = (
    "LPIPS needs --lpips-weights BACKBONE HEADS: torchvision's squeezenet1_1 or vgg16 weights (.npz, .safetensors or "
    ".pth) and the heads of `pip download --no-deps lpips==0.1.4` (unzip; lpips/weights/v0.1/squeeze.pth or vgg.pth)"
)
INPUT_SHIFT, INPUT_SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""Of images in [-1, 1]: what the heads were trained with."""
SMALLEST_SIDE_PX = 32
# A step: "c4" convolution 4 with rectifier, "f3" fire module 3, "p" the network's pooling, "." take these features.
SQUEEZE = "c0 . p f3 f4 . p f6 f7 . p f9 . f10 . f11 . f12 ."
VGG = "c0 c2 . p c5 c7 . p c10 c12 c14 . p c17 c19 c21 . p c24 c26 c28 ."
OWN_ENTRY = {"squeeze": "features.3.squeeze.weight", "vgg": "features.28.weight"}
"""An entry that only this network has."""
PLANS = {"squeeze": SQUEEZE, "vgg": VGG}


@dataclass(frozen=True)
class Lpips:
    """A backbone with its heads; call it with two images."""

    net: str
    """squeeze or vgg."""
    backbone: Layers
    """Tensors by torchvision's names."""
    heads: "list[Tensor]"
    """(1, channels, 1, 1) each, >= 0: how much every channel of every tap counts."""

    def __call__(self, image: npt.NDArray[Any], truth: npt.NDArray[Any]) -> float:
        """Return the distance of two images, uint8 or float in [0, 1], (height, width, 3); 0 for equal ones.

        Raises:
            ScoreError: the shapes differ, or the images are not RGB or smaller than the network's pooling.
        """
        import torch

        if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3:
            raise ScoreError(f"LPIPS is of two RGB images of one size, found {text(image.shape)}, {text(truth.shape)}")
        if min(image.shape[:2]) < SMALLEST_SIDE_PX:
            raise ScoreError(f"image is {text(image.shape[:2])}: LPIPS needs {SMALLEST_SIDE_PX} px each way")
        with torch.inference_mode():
            return float(self.distances(torch.stack([_tensor(image)]), torch.stack([_tensor(truth)]))[0])

    def distances(self, images: "Tensor", truths: "Tensor") -> "Tensor":
        """Return the distances (n,) of images (n, 3, height, width) in [-1, 1]."""
        import torch

        features = self._features(torch.cat([images, truths]))
        total = images.new_zeros(len(images))
        for tap, head in zip(features, self.heads, strict=True):
            unit = tap / (tap.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
            a, b = unit.chunk(2)
            total += ((a - b).square() * head).sum(dim=1).mean(dim=(1, 2))
        return total

    def _features(self, images: "Tensor") -> "list[Tensor]":
        """Return the taps of images (n, 3, height, width) in [-1, 1], near to far."""
        import torch
        from torch.nn import functional as F

        channel = (1, 3, 1, 1)
        x = (images - torch.tensor(INPUT_SHIFT).view(channel)) / torch.tensor(INPUT_SCALE).view(channel)
        x = x.to(memory_format=torch.channels_last)
        squeeze, taps = self.net == "squeeze", []
        for step in PLANS[self.net].split():
            layer = f"features.{step[1:]}"
            if step == ".":
                taps.append(x)
            elif step == "p":
                x = F.max_pool2d(x, 3, 2, ceil_mode=True) if squeeze else F.max_pool2d(x, 2, 2)
            elif step[0] == "f":
                x = self._conv(x, f"{layer}.squeeze")
                x = torch.cat([self._conv(x, f"{layer}.expand1x1"), self._conv(x, f"{layer}.expand3x3", 1)], dim=1)
            else:
                x = self._conv(x, layer, 0, 2) if squeeze else self._conv(x, layer, 1)
        return taps

    def _conv(self, x: "Tensor", name: str, padding: int = 0, stride: int = 1) -> "Tensor":
        from torch.nn import functional as F

        weight, bias = self.backbone[f"{name}.weight"], self.backbone[f"{name}.bias"]
        return F.relu(F.conv2d(x, weight, bias, stride, padding))


def load(paths: Sequence[Path]) -> Lpips:
    """Read a backbone and its heads, in either order, from one file or two.

    Raises:
        ScoreError: a file cannot be read, or the weights are not of one of the two networks with its heads.
    """
    tensors: Layers = {}
    for path in paths:
        tensors |= read_weights(path)
    named = " and ".join(map(str, paths)) or "no file"
    net = next((net for net, entry in OWN_ENTRY.items() if entry in tensors), None)
    if net is None:
        raise ScoreError(f"{named}: no backbone of SqueezeNet 1.1 or VGG16 in it: {HOW_TO_GET}")
    heads = [name for i in range(PLANS[net].count(".")) for name in tensors if name.startswith(f"lin{i}.")]
    wanted = _shapes(net)
    backbone = {name: tensor for name, tensor in tensors.items() if name in wanted}
    wrong = [name for name, shape in wanted.items() if name not in tensors or tuple(tensors[name].shape) != shape]
    channels = [tensors[name].numel() for name in heads]
    if wrong or channels != _tapped(net):
        what = f"{wrong[0]} is missing or of another shape" if wrong else f"heads of {channels or 'no'} channels"
        raise ScoreError(f"{named}: {what}, expected {net} with heads of {_tapped(net)}: {HOW_TO_GET}")
    return Lpips(net, backbone, [tensors[name].reshape(1, -1, 1, 1) for name in heads])


def read_weights(path: Path) -> Layers:
    """Read tensors by name from .npz, .safetensors or .pth, as float32; nothing in the file is executed."""
    import torch

    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                tensors: Mapping[str, Any] = {name: torch.from_numpy(file[name]) for name in file.files}
        elif path.suffix == ".safetensors":
            from safetensors.torch import load_file

            tensors = load_file(path)
        else:
            tensors = torch.load(path, map_location="cpu", weights_only=True)
        return {name: tensor.float().contiguous() for name, tensor in tensors.items()}
    except OSError as error:
        raise ScoreError(f"{path}: cannot be read ({error.strerror or error}): {HOW_TO_GET}") from error
    except Exception as error:  # three libraries, each with its own errors for a damaged file
        raise ScoreError(f"{path}: expected tensors by name, found damaged or other data: {HOW_TO_GET}") from error


def _shapes(net: str) -> dict[str, tuple[int, ...]]:
    """Return the shape of every tensor that the backbone needs."""
    shapes: dict[str, tuple[int, ...]] = {}

    def conv(name: str, inputs: int, outputs: int, size: int) -> None:
        shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (outputs, inputs, size, size), (outputs,)

    channels = 3
    for step, width in _widths(net):
        layer = f"features.{step[1:]}"
        if step[0] == "c":
            conv(layer, channels, width, 3)
        else:
            conv(f"{layer}.squeeze", channels, width // 8, 1)
            conv(f"{layer}.expand1x1", width // 8, width // 2, 1)
            conv(f"{layer}.expand3x3", width // 8, width // 2, 3)
        channels = width
    return shapes


def _widths(net: str) -> list[tuple[str, int]]:
    """List the layers with weights and how many channels each gives."""
    steps = [step for step in PLANS[net].split() if step not in (".", "p")]
    if net == "squeeze":
        return list(zip(steps, (64, 128, 128, 256, 256, 384, 384, 512, 512), strict=True))
    return list(zip(steps, (64,) * 2 + (128,) * 2 + (256,) * 3 + (512,) * 6, strict=True))


def _tapped(net: str) -> list[int]:
    """List the channels of the taps."""
    widths, last, taps = dict(_widths(net)), 0, []
    for step in PLANS[net].split():
        last = widths.get(step, last)
        if step == ".":
            taps.append(last)
    return taps


def _tensor(image: npt.NDArray[Any]) -> "Tensor":
    """Turn an image (height, width, 3) into a tensor (3, height, width) in [-1, 1]."""
    import torch

    scaled = image / np.float32(127.5) - 1 if image.dtype == np.uint8 else np.clip(image, 0, 1) * 2 - 1
    return torch.from_numpy(np.ascontiguousarray(scaled.transpose(2, 0, 1), dtype=np.float32))
