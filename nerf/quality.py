"""Quality: how long a fit trains, and which family it trains, where nobody says.

Both were chosen on KITTI drive 0009 and on streets: docs/nerf.md, "Which field, how long".
"""

from typing import Literal

Quality = Literal["fast", "default", "high"]

SECONDS: dict[Quality, float] = {"fast": 10.0, "default": 60.0, "high": 300.0}
"""How long a fit trains."""
AUTO = "auto"
"""Stands for the family that measured best."""
BEST = "mip360"
"""That family: with a prior and without, at every budget."""


def family_of(name: str) -> str:
    """Return the family that a name stands for: its own, or the best one for `auto`."""
    return BEST if name == AUTO else name
