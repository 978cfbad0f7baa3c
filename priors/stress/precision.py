"""Precisions: how the numbers that a routine is given are stored. The oracle gets the same numbers in float64."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from priors.stress.tolerances import PrecisionName

if TYPE_CHECKING:
    from torch import Tensor

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Precision:
    """A kind of numbers."""

    name: PrecisionName
    smallest: float
    """The smallest number above 0: a denormal."""
    largest: float

    def rounded(self, values: Any) -> Floats:
        """Return numbers as this precision holds them, in float64; what is too large becomes infinite."""
        exact = np.asarray(values, np.float64)
        with np.errstate(over="ignore", under="ignore"):
            if self.name == "fp16":
                return exact.astype(np.float16).astype(np.float64)
            single = exact.astype(np.float32)
            if self.name == "bf16":
                import torch

                return torch.from_numpy(np.ascontiguousarray(single)).bfloat16().double().numpy().reshape(exact.shape)
        return single.astype(np.float64)

    def array(self, values: Any) -> npt.NDArray[Any]:
        """Return numbers as numpy holds them: float16, or float32 (numpy has no bfloat16)."""
        with np.errstate(over="ignore", under="ignore"):
            return self.rounded(values).astype(np.float16 if self.name == "fp16" else np.float32)

    def tensor(self, values: Any) -> "Tensor":
        """Return numbers as a tensor of this type."""
        import torch

        kind = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}[self.name]
        return torch.from_numpy(np.ascontiguousarray(self.rounded(values))).to(kind)


FP32 = Precision("fp32", 2.0**-149, float(np.finfo(np.float32).max))
BF16 = Precision("bf16", 2.0**-133, 255 * 2.0**120)
FP16 = Precision("fp16", 2.0**-24, 65504.0)
PRECISIONS = (FP32, BF16, FP16)
