"""Quality: how long a fit trains where nobody says. Chosen on KITTI drive 0009 and on streets: docs/nerf.md."""

from typing import Literal

Quality = Literal["fast", "default", "high"]

SECONDS: dict[Quality, float] = {"fast": 10.0, "default": 60.0, "high": 300.0}
"""How long a fit trains."""
BEST = "mip360"
"""The hash family that measured best: with a prior and without, at every budget."""
GAUSSIANS = "splat"
"""The family that is better still where a dense prior shows the surfaces: nerf/choice.py."""
