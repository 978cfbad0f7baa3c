"""Legends: what the colours of a map mean, with their unit, as a bar and as a reading of each colour."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from priors.draw.colours import (
    CONFIDENCE_COLOURS,
    DEPTH_COLOURS,
    ERROR_STEPS,
    GOOD_TO_BAD,
    MISSING,
    SCALE_FARTHEST_M,
    SCALE_NEAREST_M,
    ColourTable,
)
from priors.draw.panel import CONFIDENCE_BAR, Bar, depth_bar, error_bar

NO_VALUE = "no value"


@dataclass(frozen=True, slots=True)
class Legend:
    """What the colours of a map mean."""

    title: str
    """With the unit."""
    bar: Bar
    stepped: bool = False
    """Whether each colour is an interval."""
    note: str = ""
    """What else there is to see: black, grey."""
    readings: Mapping[str, str] = field(default_factory=dict)
    """What a colour, rrggbb, means in words."""

    @property
    def stops(self) -> str:
        """Return the bar's colours as the stops of a CSS gradient."""
        colours = [hexadecimal(colour) for colour in self.bar.colours]
        if not self.stepped:
            return ", ".join(f"#{colours[i]}" for i in np.linspace(0, len(colours) - 1, 17).astype(int))
        ends = [100 * i / len(colours) for i in range(len(colours) + 1)]
        return ", ".join(
            f"#{colour} {low:g}% {high:g}%" for colour, (low, high) in zip(colours, pairwise(ends), strict=True)
        )


def hexadecimal(colour: "np.ndarray[tuple[int], np.dtype[np.uint8]] | tuple[int, ...]") -> str:
    """Write a colour (3,) as rrggbb."""
    return "".join(f"{int(channel):02x}" for channel in colour)


def depth_legend() -> Legend:
    """Make the legend of `priors.draw.colours.colour_depth`."""
    shares = np.linspace(1, 0, len(DEPTH_COLOURS))
    depths_m = SCALE_NEAREST_M * (SCALE_FARTHEST_M / SCALE_NEAREST_M) ** shares
    words = [f"{depth_m:.3g} m" for depth_m in depths_m]
    words[0], words[-1] = f"{SCALE_FARTHEST_M:g} m or more", f"{SCALE_NEAREST_M:g} m or less"
    return Legend("depth, metres", depth_bar(), note="black: no value", readings=_readings(DEPTH_COLOURS, words))


def error_legend() -> Legend:
    """Make the legend of `priors.draw.colours.colour_error`."""
    edges = [f"{100 * step:g}" for step in ERROR_STEPS]
    between = [f"{low} to {high} %" for low, high in pairwise(edges)]
    words = [f"under {edges[0]} %", *between, f"over {edges[-1]} %"]
    readings = {**_readings(GOOD_TO_BAD, words), hexadecimal(MISSING): NO_VALUE}
    note = "black: no truth there; grey: no value where there is a truth"
    return Legend("error, % of the true depth", error_bar(), True, note, readings)


def confidence_legend() -> Legend:
    """Make the legend of `priors.draw.colours.colour_confidence`."""
    words = [f"{share:.2f}" for share in np.linspace(0, 1, len(CONFIDENCE_COLOURS))]
    return Legend(
        "confidence, 0 to 1: how probably the depth is right",
        CONFIDENCE_BAR,
        note="black: no value",
        readings=_readings(CONFIDENCE_COLOURS, words),
    )


def _readings(colours: ColourTable, words: list[str]) -> dict[str, str]:
    """Give each colour its words; black is no value."""
    named = {hexadecimal(colour): word for colour, word in zip(colours, words, strict=True)}
    return {**named, "000000": NO_VALUE}
