"""The sky mask's network as PyTorch trains it; `priors/kernels/sky_net.py` runs the same layers without PyTorch.

EfficientNet-Lite0's first half sees the image down to a sixteenth of its size: ImageNet has taught it what a wall, a
tree and a cloud look like, which 468 labelled frames of three drives cannot. Narrow blocks on the way back up say
at half the size where the sky is.
"""

from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from priors.nets.blocks import conv_of
from priors.nets.mobile import FIRST, STAGES, Inverted, blocks_of, imagenet_file, layer
from priors.nets.weights import under

ENCODED = STAGES[:4]
"""The stages that are used."""
TAPPED = (0, 2, 4, 7)
"""Blocks whose features the way up takes: at 1/2, 1/4, 1/8 and 1/16."""
SIDE = (12, 20, 28, 48)
"""Channels of the way up at these sizes."""


class SkyNet(nn.Module):
    """Images (b, 3, h, w) in [0, 1] of any size to logits of sky (b, ceil(h / 2), ceil(w / 2))."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = layer(3, FIRST, 3, 2)
        blocks = blocks_of(ENCODED)
        self.blocks = nn.ModuleList(blocks)
        self.side = nn.ModuleList(layer(blocks[at].outputs, to, 1) for at, to in zip(TAPPED, SIDE, strict=True))
        self.whole = nn.Linear(SIDE[-1], SIDE[-1])
        self.look = nn.ModuleList(Inverted(SIDE[-1], SIDE[-1], 5, 1, 3) for _ in range(2))
        self.lower = nn.ModuleList(layer(below, here, 1) for here, below in pairwise(SIDE))
        self.mend = nn.ModuleList(Inverted(here, here, 3, 1, 2) for here in SIDE[:-1])
        self.last = nn.Conv2d(SIDE[0], 1, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Return logits."""
        features: Tensor = self.stem((255 * image - 127) / 128)
        levels: list[Tensor] = []
        for number, block in enumerate(self.blocks):
            features = block(features)
            if number in TAPPED:
                levels.append(self.side[len(levels)](features))
        deep = levels[-1]
        deep = deep + self.whole(deep.mean(dim=(2, 3)))[..., None, None]
        for block in self.look:
            deep = block(deep)
        for lower, mend, level in zip(reversed(self.lower), reversed(self.mend), reversed(levels[:-1]), strict=True):
            up = F.interpolate(lower(deep), size=level.shape[-2:], mode="bilinear", align_corners=False)
            deep = mend(level + up)
        logit: Tensor = self.last(deep)[:, 0]
        return logit

    def take_imagenet(self) -> None:
        """Start the encoder from ImageNet's weights; DataError where their package is missing."""
        theirs = torch.load(imagenet_file(), map_location="cpu", weights_only=True)
        self.stem[0].load_state_dict({"weight": theirs["_conv_stem.weight"]})
        self.stem[1].load_state_dict(under(theirs, "_bn0."))
        for number, block in enumerate(self.blocks):
            if not isinstance(block, Inverted):
                raise TypeError(f"{block}: expected an inverted residual block")
            block.take(under(theirs, f"_blocks.{number}."))


def fold(net: nn.Module) -> dict[str, np.ndarray]:
    """Return a network's layers as `priors/kernels/sky_net.py` takes them, normalisations folded: name.w and name.b."""
    arrays: dict[str, np.ndarray] = {}
    for name, module in net.named_modules():
        convolution: nn.Module
        if isinstance(module, nn.Sequential) and isinstance(norm := module[1], nn.BatchNorm2d):
            convolution = fuse_conv_bn_eval(conv_of(module), norm)
        elif isinstance(module, nn.Linear) or name == "last":
            convolution = module
        else:
            continue
        weight, bias = convolution.get_parameter("weight").detach(), convolution.get_parameter("bias").detach()
        if name == "stem" or weight.shape[1] > 1 or weight.dim() == 2:
            weight = weight.reshape(len(weight), -1).T
        else:
            weight = weight[:, 0]
        arrays[f"{name}.w"], arrays[f"{name}.b"] = weight.contiguous().numpy(), bias.numpy()
    return arrays
