"""Line plots drawn with OpenCV: sparsification curves, error by range. uint8 RGB, no plotting library needed."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors.draw.colours import Colour
from priors.draw.panel import FAINT, INK, PAPER, text_width, write
from priors.types import Image

PALETTE: tuple[Colour, ...] = (
    (90, 170, 250),
    (250, 160, 70),
    (110, 210, 130),
    (235, 110, 130),
    (190, 150, 245),
    (225, 215, 110),
)
GRID: Colour = (52, 56, 64)
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 62, 18, 62, 44
SUBPIXEL_BITS = 4  # cv2 takes fixed-point coordinates: curves do not step from pixel to pixel


@dataclass(frozen=True, slots=True)
class Line:
    """One curve."""

    label: str
    x: npt.NDArray[np.floating]
    """(n,)"""
    y: npt.NDArray[np.floating]
    """(n,); points that are not finite are left out."""
    dashed: bool = False
    """Draw it as a reference, not as a result."""


def plot(
    lines: Sequence[Line],
    x_label: str,
    y_label: str,
    title: str = "",
    size: tuple[int, int] = (400, 640),
    from_zero: bool = True,
) -> Image:
    """Draw curves over common axes; size is (height, width).

    The y axis starts at 0 where nothing is negative, or else (decibels) near the smallest value.
    """
    height, width = size
    canvas = np.full((height, width, 3), PAPER, np.uint8)
    x_ticks = ticks(*_span([line.x for line in lines]))
    low, high = _span([line.y for line in lines])
    y_ticks = ticks(min(0.0, low) if from_zero else low, high)
    to_x = _Axis(x_ticks, LEFT_PX, width - RIGHT_PX)
    to_y = _Axis(y_ticks, height - BOTTOM_PX, TOP_PX)
    for value in x_ticks:
        at = round(float(to_x(value)))
        cv2.line(canvas, (at, TOP_PX), (at, height - BOTTOM_PX), GRID, 1)
        write(canvas, f"{value:g}", (at, height - BOTTOM_PX + 16), FAINT, 0.38, centred=True)
    for value in y_ticks:
        at = round(float(to_y(value)))
        cv2.line(canvas, (LEFT_PX, at), (width - RIGHT_PX, at), GRID, 1)
        write(canvas, f"{value:g}", (LEFT_PX - 6 - text_width(f"{value:g}", 0.38), at + 4), FAINT, 0.38)
    write(canvas, x_label, ((LEFT_PX + width - RIGHT_PX) // 2, height - 10), FAINT, centred=True)
    write(canvas, f"{title}{' - ' * bool(title)}{y_label}", (LEFT_PX, 20), INK, 0.46)
    _draw_legend(canvas, lines)
    for line, colour in zip(lines, _colours(lines), strict=True):
        _draw_line(canvas, to_x(line.x), to_y(line.y), colour, line.dashed)
    return canvas


def ticks(low: float, high: float, about: int = 6) -> npt.NDArray[np.float64]:
    """Return round values that enclose low..high in about so many steps of 1, 2 or 5 times a power of ten."""
    rough = max((high - low) / about, 1e-12 * max(1.0, abs(low)))
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= rough * 0.999)
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return np.arange(first, max(last, first + 1) + 1) * step


@dataclass(frozen=True, slots=True)
class _Axis:
    """Maps values to pixels."""

    ticks: npt.NDArray[np.float64]
    first_px: float
    last_px: float

    def __call__(self, value: npt.NDArray[np.floating] | float) -> npt.NDArray[np.float64]:
        share = (np.asarray(value, dtype=np.float64) - self.ticks[0]) / (self.ticks[-1] - self.ticks[0])
        return self.first_px + share * (self.last_px - self.first_px)


def _span(series: Sequence[npt.NDArray[np.floating]]) -> tuple[float, float]:
    """Return the smallest and the largest finite value; 0..1 where there is none."""
    values = np.concatenate([np.zeros(0), *series])
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)


def _colours(lines: Sequence[Line]) -> list[Colour]:
    """Give each line its colour."""
    return [PALETTE[i % len(PALETTE)] for i in range(len(lines))]


def _draw_legend(canvas: Image, lines: Sequence[Line]) -> None:
    """Write the labels in one row above the axes, each behind a piece of its line."""
    x = float(LEFT_PX)
    for line, colour in zip(lines, _colours(lines), strict=True):
        _draw_line(canvas, np.array([x, x + 24]), np.array([42.0, 42.0]), colour, line.dashed)
        write(canvas, line.label, (round(x) + 30, 46), INK, 0.4)
        x += 48 + text_width(line.label, 0.4)


def _draw_line(
    canvas: Image, x_px: npt.NDArray[np.float64], y_px: npt.NDArray[np.float64], colour: Colour, dashed: bool
) -> None:
    """Draw a curve through points in pixels, in place; dashes are 7 px long with gaps of 5."""
    finite = np.isfinite(x_px) & np.isfinite(y_px)
    points = np.stack([x_px[finite], y_px[finite]], axis=1)
    pieces = [points]
    if dashed and len(points) > 1:
        along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        starts = np.arange(0, along[-1], 12.0)
        ends = np.minimum(starts + 7.0, along[-1])
        pieces = [
            np.stack([np.interp(cut, along, points[:, i]) for i in range(2)], axis=1)
            for start, end in zip(starts, ends, strict=True)
            for cut in [np.linspace(start, end, 4)]
        ]
    fixed = [np.rint(piece * 2**SUBPIXEL_BITS).astype(np.int32)[:, None] for piece in pieces]
    cv2.polylines(canvas, fixed, False, colour, 2, cv2.LINE_AA, SUBPIXEL_BITS)
