"""A device that is not there: its tensors hold CPU tensors, and refuse to meet those of the CPU, as a GPU's do.

It goes by the name of torch's `meta` device, for which torch asks no driver. Other than on `meta`, everything is
computed, also what has to be waited for. Whoever turns such a tensor into an array gets an error, as on a GPU.
"""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")
CROSSING = ("aten._to_copy.default", "aten.copy_.default")
"""The operations that bring tensors from one device to another."""


class Away(Tensor):
    """A tensor of that device."""

    inner: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> "Away":
        made = Tensor._make_wrapper_subclass(
            cls,
            inner.size(),
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=DEVICE,
        )
        made.inner = inner
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return computed(func, args, kwargs or {})


class Elsewhere(TorchDispatchMode):
    """While it is on, what is made on the device is made."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return computed(func, args, kwargs or {})


def computed(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """Do an operation on the CPU tensors within; RuntimeError where devices meet."""
    tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
    away = any(isinstance(x, Away) for x in tensors)
    if away and str(func) not in CROSSING and any(not isinstance(x, Away) and x.dim() for x in tensors):
        raise RuntimeError(f"{func}: tensors of two devices meet")
    if kwargs.get("device") is not None:
        away = torch.device(kwargs["device"]) == DEVICE
        kwargs = kwargs | {"device": "cpu"}
    if "out" not in kwargs and func._schema.is_mutable:
        func(*tree_map(_inner, args), **tree_map(_inner, kwargs))
        return args[0]
    made = func(*tree_map(_inner, args), **tree_map(_inner, kwargs))
    return tree_map(lambda x: Away(x) if away and isinstance(x, Tensor) else x, made)


def _inner(x: Any) -> Any:
    return x.inner if isinstance(x, Away) else x


def let_numbers_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make tensors of Python numbers pass through here: torch fills those of `meta` with nothing."""
    make: Callable[..., Tensor] = torch.tensor

    def tensor(data: Any, *, dtype: torch.dtype | None = None, device: Any = None) -> Tensor:
        made = make(data, dtype=dtype)
        return Away(made) if device is not None and torch.device(device) == DEVICE else made

    def new_tensor(self: Tensor, data: Any, dtype: torch.dtype | None = None) -> Tensor:
        return tensor(data, dtype=dtype or self.dtype, device=self.device)

    monkeypatch.setattr(torch, "tensor", tensor)
    monkeypatch.setattr(Tensor, "new_tensor", new_tensor)
