"""int8 inference: convolutions of 8-bit integers in stereo networks, on CPUs with VNNI.

VNNI multiplies four pairs of them at a time. The ranges of the large 2D convolutions' inputs were measured on drives
that trained the network (learn/int8_ranges.py), and lie beside its weights: FILE.int8.json. Weights get a scale for
each output (Krishnamoorthi 2018, "Quantizing deep convolutional networks for efficient inference", section 3), inputs
one scale and zero for all. Everything else of the network stays as it is. Without VNNI pairs of products saturate at 16
bits, so that it is refused there.
"""

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import torch
from torch import Tensor, nn

from priors.errors import DataError
from priors.machine import cpu, threads
from priors.nets import weights
from priors.nets.tensors import as_bits

LEAST_INPUTS, LEAST_OUTPUTS = 28, 9
"""Channels from which on a convolution gains more than rounding its input costs."""


@dataclass(frozen=True, slots=True)
class ActivationRange:
    """Where the values of a convolution's input lie, 0 among them."""

    low: float
    high: float

    @property
    def scale(self) -> float:
        """What a step of the 8 bits stands for."""
        return max(self.high - self.low, 1e-6) / 255

    @property
    def zero(self) -> int:
        """The number that stands for 0."""
        return round(-self.low / self.scale)


class IntegerConv(nn.Module):
    """A 2D convolution on 8 bits, plus a given map, and a ReLU; takes and gives what it stands in for."""

    def __init__(self, conv: nn.Conv2d, span: ActivationRange) -> None:
        super().__init__()
        self.span = span
        self.shape = [list(map(int, sizes)) for sizes in (conv.stride, conv.padding, conv.dilation)]
        weight = conv.weight.detach().float()
        self.scales = weight.abs().amax((1, 2, 3)).clamp(min=1e-12) / 127
        whole = (weight / self.scales[:, None, None, None]).round().to(torch.int8)
        pack = torch.ops.onednn.qconv_prepack
        self.weight = pack(whole, self.scales, span.scale, span.zero, *self.shape, conv.groups, None)
        self.zeros = torch.zeros(len(self.scales), dtype=torch.int32)
        self.bias = None if conv.bias is None else conv.bias.detach().float()
        self.groups = conv.groups

    def forward(self, x: Tensor, plus: Tensor | None = None, to: ActivationRange | None = None) -> Tensor:
        """Return relu(conv(x) + plus), (b, channels, h, w), of x's type, or in 8 bits for what has the range `to`.

        x may be in 8 bits of its own range already; the result has then the type of `plus`.
        """
        whole = x if x.dtype == torch.uint8 else self._rounded(x)
        given = whole, self.span.scale, self.span.zero, self.weight, self.scales, self.zeros
        scale, zero, kind = (1.0, 0, x.dtype) if to is None else (to.scale, to.zero, torch.uint8)
        run = torch.ops.onednn.qconv2d_pointwise
        if plus is None:
            out: Tensor = run(*given, self.bias, *self.shape, self.groups, scale, zero, kind, "relu", [], "")
            return out
        total = plus.clone()  # it is added to in place
        return run.binary(
            *given, total, self.bias, *self.shape, self.groups, 1.0, 0, plus.dtype, 1.0, 0, "sum", 1.0, "relu", [], ""
        )

    def _rounded(self, x: Tensor) -> Tensor:
        """Return x in 8 bits, channels-last."""
        from priors.kernels import quantise as kernels

        plain = x.permute(0, 2, 3, 1).contiguous()
        out = torch.empty(plain.shape, dtype=torch.uint8)
        bits, flat = as_bits(plain).reshape(-1), out.view(-1).numpy()
        numbers = torch.tensor([1 / self.span.scale, self.span.zero]).numpy()
        threads.over(
            len(bits),
            lambda first, last: kernels.quantise(bits, numbers[0], numbers[1], flat, first, last),
            threads.worth(kernels.ITEM_NS),
        )
        return out.permute(0, 3, 1, 2)


def candidates(net: nn.Module) -> dict[str, nn.Conv2d]:
    """Return the convolutions that are worth it, by name: those that a ReLU follows. Logits keep their precision."""
    return {
        name: layer
        for name, layer in net.named_modules()
        if isinstance(layer, nn.Conv2d)
        and name.endswith(".0")  # the first of a block: see blocks.conv
        and layer.kernel_size == (3, 3)
        and layer.in_channels >= LEAST_INPUTS
        and layer.out_channels >= LEAST_OUTPUTS
    }


def mark(net: nn.Module, file: Path) -> None:
    """Note at each candidate the range that was measured for a file of weights; fused.py does the rest."""
    ranges = read(file)
    for name, layer in candidates(net).items():
        if name not in ranges:
            raise DataError(
                f"{beside(file)}: no range for {name}: made for another network: run priors.learn.int8_ranges"
            )
        layer.span = ranges[name]  # type: ignore[assignment]


def beside(file: Path) -> Path:
    """Return where the ranges of a file of weights lie."""
    return file.with_suffix(".int8.json")


def read(file: Path) -> dict[str, ActivationRange]:
    """Read the ranges of a file of weights; DataError where there are none or they are of other weights."""
    path = beside(file)
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no ranges for int8: make them with python -m priors.learn.int8_ranges") from error
    if record.get("weights") != weights.digest(file):
        raise DataError(f"{path}: ranges of other weights: make them again with python -m priors.learn.int8_ranges")
    return {name: ActivationRange(*ends) for name, ends in record["ranges"].items()}


def runs(net: str | None, size: str, file: Path | None = None) -> bool:
    """Tell whether a network with its weights has ranges, and this CPU the instructions."""
    try:
        return available() and net is not None and bool(read(weights.find(net, size, file)))
    except DataError:
        return False


def digest(file: Path) -> str:
    """Return the hash of a file of weights together with its ranges: what decides the maps."""
    spans = sorted((name, span.low, span.high) for name, span in read(file).items())
    return sha256(f"{weights.digest(file)} {spans}".encode()).hexdigest()


def available() -> bool:
    """Tell whether this CPU, in its mode, multiplies 8-bit integers without overflow."""
    return cpu.mode() in ("amx", "avx512_bf16", "avx512") and "avx512vnni" in cpu.features()
