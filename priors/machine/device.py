"""The device to compute on, by name."""

from priors.errors import UsageError


def pick_device(name: str) -> str:
    """Decide "auto": a GPU where there is one; UsageError where one is asked for and PyTorch has none."""
    import torch

    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device cuda: PyTorch finds no GPU here: leave --device out, or install its CUDA build")
    return ("cuda" if torch.cuda.is_available() else "cpu") if name == "auto" else name
