"""A batch of training crops."""

from typing import TypeAlias

from torch import Tensor

Batch: TypeAlias = dict[str, Tensor]
"""Tensors by name; the first axis of each counts the crops."""
