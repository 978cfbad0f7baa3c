"""Flat memory is what a kernel takes. Pairs of bfloat16 are read as 32-bit words: their strides would be overlooked."""

import torch
from torch import Tensor


def words(pairs: Tensor) -> Tensor:
    """View pairs of bfloat16 (..., 2), one after the other in memory, as words (...) of 32 bits.

    Raises ValueError for other numbers and for pairs that are not contiguous: a kernel would read the wrong ones.
    """
    if pairs.dtype != torch.bfloat16 or pairs.shape[-1] != 2 or not pairs.is_contiguous():
        other = f"{pairs.dtype} of shape {tuple(pairs.shape)} and strides {pairs.stride()}"
        raise ValueError(f"expected contiguous pairs of bfloat16, found {other}")
    return pairs.view(torch.int32).squeeze(-1)


def flat(pairs: Tensor) -> Tensor:
    """Round pairs (..., 2) to bfloat16, contiguous, as `words` takes them; as they are where they are so already."""
    return pairs.to(torch.bfloat16).contiguous()
