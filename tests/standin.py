"""A stereo network for tests: small, with a layer to learn, and right where an image has texture."""

from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.nets import runtime, weights
from priors.nets.blocks import conv

SHARPNESS = 400.0


@dataclass
class Out:
    disparity_px: Tensor
    sigma_px: Tensor
    doubt: Tensor


class Standin(nn.Module):
    """Sum of absolute differences over 7x7 windows, and the mean of its softmin."""

    def __init__(self, size: str = "m") -> None:
        super().__init__()
        self.features = conv(3, {"s": 4, "m": 8, "l": 16}[size])
        self.mix = nn.Conv2d(3, 3, 1)
        self.asked: list[int] = []
        with torch.no_grad():
            self.mix.weight.copy_(torch.eye(3)[..., None, None])
            self.mix.bias.zero_()

    def forward(self, left: Tensor, right: Tensor, largest_px: int) -> Out:
        self.asked.append(largest_px)
        left, right = (view / 255 if view.dtype == torch.uint8 else view for view in (left, right))
        dtype = self.mix.weight.dtype
        left, right = self.mix(left.to(dtype)).float(), self.mix(right.to(dtype)).float()
        padded = F.pad(right, (largest_px, 0, 0, 0), mode="replicate")
        width = left.shape[-1]
        costs = [(left - padded[..., largest_px - d : largest_px - d + width]).abs().mean(1) for d in range(largest_px)]
        cost = F.avg_pool2d(F.pad(torch.stack(costs, dim=1), (3, 3, 3, 3), mode="replicate"), 7, 1)
        share = (-SHARPNESS * cost).softmax(dim=1)
        plane = torch.arange(largest_px, dtype=torch.float32)[:, None, None]
        mean = (share * plane).sum(1)
        sigma = (share * (plane - mean[:, None]).square()).sum(1).clamp(min=1e-6).sqrt()
        return Out(mean, sigma, sigma.log() + 0.0 * self.features(left.to(dtype)).float().mean(1))


def install(monkeypatch: pytest.MonkeyPatch, folder: Path, name: str = "cfnet", size: str = "m") -> Path:
    """Let `name` be the stand-in, with weights in a folder of its own; returns the file of weights."""
    monkeypatch.setattr(runtime, "create", lambda name, size: Standin(size))
    monkeypatch.setattr(runtime, "_loaded", {})
    monkeypatch.setattr(weights, "FOLDER", folder)
    torch.manual_seed(0)
    path = folder / f"{name}-{size}.safetensors"
    weights.write(path, Standin(size), {"net": name, "size": size})
    return path
