"""The device to compute on, by name."""


def pick_device(name: str) -> str:
    """Decide "auto": a GPU where there is one; other names are as they are."""
    import torch

    return ("cuda" if torch.cuda.is_available() else "cpu") if name == "auto" else name
