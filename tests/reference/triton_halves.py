"""bfloat16 as GPUs have it, for Triton's interpreter, which (3.9) multiplies the bits as whole numbers and cuts off."""

from typing import Any

import numpy as np
import numpy.typing as npt


def mend() -> None:
    """Teach the interpreter to round to the nearest bfloat16 and to multiply what the bits mean."""
    import triton.language as tl
    from triton.runtime import interpreter

    convert, dot = interpreter._convert_float, interpreter.InterpreterBuilder.create_dot

    def converted(data: npt.NDArray[Any], source: Any, target: Any, rounding: Any) -> npt.NDArray[Any]:
        if (source, target) == (tl.bfloat16, tl.float32):
            return widened(data).view(np.uint32)
        if (source, target) == (tl.float32, tl.bfloat16):
            bits = np.ascontiguousarray(data).view(np.uint32)
            return ((bits + (0x7FFF + (bits >> 16 & 1))) >> 16).astype(np.uint16)
        return convert(data, source, target, rounding)

    def widened(data: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        return (np.ascontiguousarray(data).view(np.uint16).astype(np.uint32) << 16).view(np.float32)

    def product(self: Any, a: Any, b: Any, d: Any, precision: Any, imprecise: Any) -> Any:
        if a.dtype.scalar != tl.bfloat16:
            return dot(self, a, b, d, precision, imprecise)
        return interpreter.TensorHandle(widened(a.data) @ widened(b.data) + d.data, d.dtype.scalar)

    interpreter._convert_float = converted
    interpreter.InterpreterBuilder.create_dot = product
