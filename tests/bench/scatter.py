"""A plot of error against time: one labelled dot a method, time on a logarithmic axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from priors.draw.panel import FAINT, INK, PAPER, text_width, write
from priors.draw.plot import GRID, PALETTE, ticks
from priors.types import Image

LEFT, RIGHT, TOP, BOTTOM = 70, 30, 44, 52
LABEL_SCALE = 0.42
NEAR = 3
"""Pixels of time within which dots are above one another."""


@dataclass(frozen=True, slots=True)
class Dot:
    """One method."""

    label: str
    milliseconds: float
    error: float
    family: int = 0
    """Which colour; dots of one family are joined."""


def scatter(dots: Sequence[Dot], error_name: str, title: str, size: tuple[int, int] = (520, 860)) -> Image:
    """Draw the dots; size is (height, width). Lower left is better."""
    height, width = size
    canvas = np.full((height, width, 3), PAPER, np.uint8)
    low = np.floor(np.log10(min(dot.milliseconds for dot in dots)) * 3) / 3
    high = np.ceil(np.log10(max(dot.milliseconds for dot in dots) * 1.6) * 3) / 3
    y_ticks = ticks(0.0, max(dot.error for dot in dots) * 1.05)

    def at(milliseconds: float, error: float) -> tuple[int, int]:
        x = LEFT + (np.log10(milliseconds) - low) / max(high - low, 1e-6) * (width - LEFT - RIGHT)
        y = height - BOTTOM - error / y_ticks[-1] * (height - TOP - BOTTOM)
        return round(float(x)), round(float(y))

    for value in y_ticks:
        x, y = at(10**low, value)
        cv2.line(canvas, (LEFT, y), (width - RIGHT, y), GRID, 1)
        write(canvas, f"{value:g}", (x - 8 - text_width(f"{value:g}", 0.38), y + 4), FAINT, 0.38)
    for value in (base * 10**power for power in range(6) for base in (1, 2, 5)):
        if low <= np.log10(value) <= high:
            x, y = at(value, 0)
            cv2.line(canvas, (x, TOP), (x, y), GRID, 1)
            text = f"{value} ms" if value < 1000 else f"{value / 1000:g} s"
            write(canvas, text, (x, y + 18), FAINT, 0.38, centred=True)
    write(canvas, "time a pair", ((LEFT + width - RIGHT) // 2, height - 12), FAINT, centred=True)
    write(canvas, f"{title} - {error_name}", (LEFT, 24), INK, 0.46)
    _draw_dots(canvas, [(dot, at(dot.milliseconds, dot.error)) for dot in dots])
    return canvas


def _draw_dots(canvas: Image, placed: Sequence[tuple[Dot, tuple[int, int]]]) -> None:
    """Join each family's dots in order of time, then draw and label them.

    Labels step aside for each other, and stand in the order of their dots where those are above one another.
    """
    families = sorted({dot.family for dot, _ in placed})
    for family in families:
        points = sorted(point for dot, point in placed if dot.family == family)
        cv2.polylines(canvas, [np.array(points, np.int32)], False, PALETTE[family % len(PALETTE)], 1, cv2.LINE_AA)
    taken: list[tuple[int, int, int, int]] = []
    labelled: list[tuple[int, int, int]] = []
    for dot, (x, y) in sorted(placed, key=lambda pair: pair[1]):
        cv2.circle(canvas, (x, y), 5, PALETTE[dot.family % len(PALETTE)], -1, cv2.LINE_AA)
        wide = round(text_width(dot.label, LABEL_SCALE))
        left = x + 10 if x + 10 + wide < canvas.shape[1] else x - 10 - wide
        best = next(
            (left, y + step)
            for step in (-8, 16, -24, 32, -40, 48, -56, 64, *range(80, 2000, 16))
            if all(left + wide < a or left > b or y + step - 12 > d or y + step < c for a, c, b, d in taken)
            and all(abs(x - there) > NEAR or (y - above) * (y + step - label) >= 0 for there, above, label in labelled)
        )
        labelled.append((x, y, best[1]))
        taken.append((best[0], best[1] - 12, best[0] + wide, best[1] + 2))
        write(canvas, dot.label, best, INK, LABEL_SCALE)
