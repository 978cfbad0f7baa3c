"""Tolerances of the stress tables: all of them, in one place. Each is a share of a result's natural scale.

A result's natural scale is its own size where nothing else is said. A sum of large parts has that of its largest part,
a metric that is a difference that of what it is the difference of; each routine says so where it is tested.
"""

from typing import Literal, TypeAlias

PrecisionName: TypeAlias = Literal["fp32", "bf16", "fp16"]

VALUE: dict[PrecisionName, float] = {"fp32": 1e-5, "bf16": 2.0**-7, "fp16": 2.0**-10}
"""Largest error of a value: float32 as the issue of accumulated rounding, the halves at two units in the last place."""
GRADIENT: dict[PrecisionName, float] = {"fp32": 1e-4, "bf16": 2.0**-7, "fp16": 2.0**-10}
"""Largest error of a gradient against central differences in float64, of the argument's largest gradient."""
STEP = 1e-6
"""Step of a central difference, as a share of the value that it moves (of the argument's usual value, where larger).

A second one is four times as long: by how much the two differ is taken for what a difference leaves open, at a kink or
where the loss is far larger than what moves it."""
LEAST = 1e-6
"""A gradient by which a value of usual size moves less than this share of the loss is as good as 0."""
PLACES = 6
"""Values of each argument whose gradient is compared."""


def told() -> str:
    """Say in one line what fails."""
    values = ", ".join(f"{name} {tolerance:.2g}" for name, tolerance in VALUE.items())
    return f"a value fails above {values}, a gradient above {GRADIENT['fp32']:.2g} (fp32), of the natural scale"
