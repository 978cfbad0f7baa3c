"""Finding: what the check before a fit came to; config.json keeps it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

APART = 1.1
"""Scales by the images and by the LiDAR that differ by more than this are worth a line."""
NOTABLE = 1.03
"""Factors up to this are worth no line."""
MUCH_SKY = 0.1
"""Share of the sky from which on a prior's surfaces in it are worth a line."""


@dataclass(frozen=True)
class Finding:
    """What was found of a scene and its prior, and what was done about it."""

    patches: int = 0
    """Patches that were looked for in other images; 0: the images cannot tell."""
    scale: float = 1.0
    """What the depths were multiplied by, the median over the frames; 1: they were left as they are."""
    spread: tuple[float, float] = (1.0, 1.0)
    """The smallest and the largest such factor of a frame."""
    dropped: float = 0.0
    """Share of the values that was left out, since the other frames contradict them."""
    wrong: float = 0.0
    """Share of the patches that are found at another depth, among those that are found at all; of what was kept."""
    used: bool = True
    """Whether the fit uses the prior; else it goes on by colours."""
    lidar: float | None = None
    """What the depths would be multiplied by to be the LiDAR's; None: there is none."""
    sky: float = 0.0
    """Share of the sky's pixels, by the images, at which the prior is sure of a surface."""
    blank: tuple[str, ...] = ()
    """Frames whose images show nothing; they do not train."""

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "Finding":
        """Make it of what JSON holds."""
        return cls(**{**record, "spread": tuple(record["spread"]), "blank": tuple(record["blank"])})

    def told(self, prior: str | None) -> list[str]:
        """Say it, a line each, what is worth one; `prior`: what it is called, where there is one."""
        lines = []
        if self.blank:
            some = ", ".join(self.blank[:5]) + (", ..." if len(self.blank) > 5 else "")
            lines.append(f"images: {some}: blank, left out of training (--align none keeps them)")
        return lines if prior is None else [*lines, *self._of_prior(f"prior: {prior}")]

    def _of_prior(self, prior: str) -> list[str]:
        """Say what was found of the prior; `prior`: how a line of it begins."""
        if not self.used:
            return [f"{prior} is left out, the fit goes on by colours: {self._why()} (--align none uses it as it is)"]
        lines = []
        if not self.patches:
            witness = "" if self.lidar is None else "; its scale is the LiDAR's"
            lines.append(f"{prior} could not be checked: the images overlap or move too little{witness}")
        low, high = self.spread
        if max(high, 1 / low) > NOTABLE:
            lines.append(self._scaled(prior))
        if self.patches and self.lidar is not None and not 1 / APART < self.lidar / self.scale < APART:
            lines.append(
                f"{prior} suits the images at {self.scale:.2f} times its depth, the LiDAR at {self.lidar:.2f}: the"
                " poses' scale, or the LiDAR's place, is off (`priors check` tells more)"
            )
        if self.dropped >= 0.005:
            lines.append(f"{prior}: {self.dropped:.0%} of its values contradict other frames' and are left out")
        if self.sky >= MUCH_SKY:
            lines.append(f"{prior} has surfaces in {self.sky:.0%} of the sky (--sky mask drops them)")
        return lines

    def _why(self) -> str:
        """Say why it is left out."""
        if self.dropped > self.wrong:
            return f"{self.dropped:.0%} of its values contradict other frames'"
        return f"{self.wrong:.0%} of what other images show lies at another depth"

    def _scaled(self, prior: str) -> str:
        """Say what its depths were multiplied by."""
        low, high = self.spread
        size, times = "too near" if self.scale > 1 else "too far", f"{self.scale:.2f}"
        if low < self.scale / NOTABLE or self.scale * NOTABLE < high:
            size, times = "of a scale that drifts", f"{low:.2f} to {high:.2f}"
        cause = "the scale is another one: of its units, or of the poses; --align none keeps them"
        return f"{prior} is {size}: its depths are multiplied by {times} ({cause})"
