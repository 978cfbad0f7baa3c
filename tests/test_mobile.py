"""The mobile encoder: ImageNet's weights, and fused depthwise layers."""

import pytest
import torch
import torch.nn.functional as F

from priors.errors import DataError
from priors.nets import mobile
from priors.nets.blocks import channels_last, fold
from priors.nets.fused import fuse
from priors.nets.trunk import normalise


def test_the_encoder_starts_as_imagenet_left_it() -> None:
    """The first layer answers to an image as the package's own weights do to (image - 127) / 128, borders left out."""
    try:
        theirs = torch.load(mobile.imagenet_file(), weights_only=True)
    except DataError as error:
        pytest.skip(str(error))
    encoder = mobile.Mobile(inputs=5).eval()
    encoder.take_imagenet()
    image = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    norm = [theirs[f"_bn0.{name}"] for name in ("running_mean", "running_var", "weight", "bias")]
    expected = F.conv2d((image * 255 - 127) / 128, theirs["_conv_stem.weight"], stride=2, padding=1)
    expected = F.batch_norm(expected, *norm, eps=1e-3).clamp(0, 6)
    with torch.no_grad():
        found = encoder.stem(torch.cat([normalise(image), torch.rand(1, 2, 64, 96)], dim=1))
    torch.testing.assert_close(found[..., 1:, 1:], expected[..., 1:, 1:], atol=1e-4, rtol=1e-4)
    block = encoder.blocks[5]
    assert isinstance(block, mobile.Inverted)
    torch.testing.assert_close(block.look[0].weight, theirs["_blocks.5._depthwise_conv.weight"])
    assert [tuple(level.shape) for level in encoder(torch.zeros(1, 5, 64, 96))] == [
        (1, channels, 64 // step, 96 // step) for channels, step in zip(encoder.channels, (4, 8, 16, 32), strict=True)
    ]


def test_fused_depthwise_layers_compute_the_same() -> None:
    """ReLU6, groups and strides survive the fusion; both nets are bf16, so only its rounding is left."""
    torch.manual_seed(1)
    encoder = mobile.Mobile(inputs=5).eval()
    with torch.no_grad():
        for layer in encoder.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.weight.fill_(4.0)  # so that ReLU6's upper bound counts
    image = torch.randn(1, 5, 64, 96).to(torch.bfloat16, memory_format=torch.channels_last)
    plain = channels_last(fold(encoder).to(torch.bfloat16))
    with torch.inference_mode():
        expected = plain.stem(image)
        first, second = plain.blocks[0](expected), plain.blocks[1](plain.blocks[0](expected))
        fused = fuse(plain)
        found = fused.stem(image)
        assert float(expected.max()) == 6 == float(found.max())
        for ours, theirs in zip((fused.blocks[0](expected), fused.blocks[1](first)), (first, second), strict=True):
            torch.testing.assert_close(ours, theirs, atol=0.05, rtol=0.05)
