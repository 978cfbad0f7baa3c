"""Finding: what the check of a prior came to; config.json keeps it."""

from dataclasses import dataclass

UNCHECKED = 0
"""Patches of a prior that could not be checked."""


@dataclass(frozen=True)
class Finding:
    """What was found of a prior, and what was done about it."""

    patches: int = UNCHECKED
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

    def told(self, prior: str) -> list[str]:
        """Say it, a line each, what is worth one; `prior`: what it is called."""
        if not self.patches:
            return [f"prior: {prior} could not be checked: the images overlap or move too little"]
        if not self.used:
            cause = f"{self.wrong:.0%} of what other images show lies at another depth"
            if self.dropped > self.wrong:
                cause = f"{self.dropped:.0%} of its values contradict other frames'"
            return [f"prior: {prior} is left out, the fit goes on by colours: {cause} (--align none uses it as it is)"]
        lines = []
        if self.scale != 1 or self.spread != (1.0, 1.0):
            size = "too near" if self.scale > 1 else "too far"
            low, high = self.spread
            frames = "" if high < 1.05 * low else f", {low:.2f} to {high:.2f} from frame to frame"
            cause = "the scale is another one: of its units, or of the poses"
            lines.append(
                f"prior: {prior} is {size}: its depths are multiplied by {self.scale:.2f}{frames}"
                f" ({cause}; --align none keeps them)"
            )
        if self.dropped >= 0.005:
            lines.append(f"prior: {self.dropped:.0%} of its values contradict other frames' and are left out")
        return lines
