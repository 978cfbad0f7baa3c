"""State dictionaries: the named tensors of a model's parts, joined under the parts' names and copied back."""

from collections.abc import Mapping

from torch import Tensor

from priors.nets import weights


def joined(parts: Mapping[str, Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """Name every tensor after its part: "part.name"."""
    return {f"{part}.{name}": tensor for part, state in parts.items() for name, tensor in state.items()}


def under(part: str, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return a part's tensors by their own names: `joined` undone."""
    return weights.under(state, f"{part}.")


def copy_into(own: Mapping[str, Tensor], saved: Mapping[str, Tensor]) -> None:
    """Copy saved tensors into those of the same names; other saved ones are left.

    Raises:
        ValueError: one is missing or has another shape; nothing was copied then.
    """
    for name, tensor in own.items():
        if name not in saved or saved[name].shape != tensor.shape:
            other = tuple(saved[name].shape) if name in saved else "none"
            raise ValueError(f"expected {name} of shape {tuple(tensor.shape)}, found {other}")
    for name, tensor in own.items():
        tensor.copy_(saved[name])
