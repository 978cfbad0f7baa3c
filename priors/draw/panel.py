"""Captioned pictures side by side: tiles with a colour bar each, laid out in a panel.

All pictures are uint8 RGB (height, width, 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from priors.draw.colours import (
    CONFIDENCE_COLOURS,
    DEPTH_COLOURS,
    ERROR_STEPS,
    GOOD_TO_BAD,
    SCALE_FARTHEST_M,
    SCALE_NEAREST_M,
    Colour,
    ColourTable,
    colour_confidence,
    colour_depth,
    colour_error,
    thicken,
)
from priors.types import Depth, Image

INK: Colour = (236, 238, 242)
FAINT: Colour = (150, 156, 166)
PAPER: Colour = (24, 26, 31)
FONT, TEXT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
STRIP_PX, GAP_PX = 36, 6
SPARSE = 0.5
"""Maps with a smaller share of values are thickened."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A colour bar: what the colours of a tile mean."""

    colours: ColourTable
    """(n, 3) RGB from left to right."""
    ticks: Sequence[tuple[float, str]]
    """Where along the bar, in [0, 1], and what is written there."""


@dataclass(frozen=True, slots=True)
class Tile:
    """One picture of a panel."""

    picture: Image
    caption: str
    bar: Bar | None = None


def depth_bar(nearest_m: float = SCALE_NEAREST_M, farthest_m: float = SCALE_FARTHEST_M) -> Bar:
    """Make the bar of `colour_depth`."""
    marks = [m for m in (3, 5, 10, 20, 40, 80, 160) if nearest_m <= m <= farthest_m]
    shares = [float(np.log(m / nearest_m) / np.log(farthest_m / nearest_m)) for m in marks]
    labels = [f"{m} m" if m == marks[-1] else str(m) for m in marks]
    return Bar(DEPTH_COLOURS[::-1], list(zip(shares, labels, strict=True)))


def error_bar() -> Bar:
    """Make the bar of `colour_error`."""
    steps = len(ERROR_STEPS) + 1
    labels = [*(f"{100 * step:g}" for step in ERROR_STEPS[:-1]), f"{100 * ERROR_STEPS[-1]:g}%"]
    return Bar(GOOD_TO_BAD, [((i + 1) / steps, label) for i, label in enumerate(labels)])


CONFIDENCE_BAR = Bar(CONFIDENCE_COLOURS, [(0.0, "0"), (0.5, "0.5"), (1.0, "1")])


def depth_tile(depth: Depth, name: str) -> Tile:
    """Make the tile of a depth map; a sparse one is thickened."""
    picture = colour_depth(depth.depth_m)
    caption = f"{name}: {100 * depth.density:.1f} % of the pixels"
    return Tile(thicken(picture) if depth.density < SPARSE else picture, caption, depth_bar())


def error_tile(depth: Depth, truth: Depth) -> Tile:
    """Make the tile of a depth map's error where there is a truth; thickened, since a truth is sparse."""
    picture = colour_error(depth.depth_m, truth.depth_m)
    missing = truth.valid & ~depth.valid
    caption = "error, share of the truth" + (" (grey: no value)" if missing.any() else "")
    if np.count_nonzero(missing) > (1 - SPARSE) * np.count_nonzero(truth.valid):
        # Few of the truth's pixels have a value: these must be seen, so they grow over the missing ones.
        errors = thicken(np.where(missing[..., None], np.uint8(0), picture))
        picture = np.where(errors.any(axis=2, keepdims=True), errors, picture)
    return Tile(thicken(picture), caption, error_bar())


def confidence_tile(depth: Depth) -> Tile:
    """Make the tile of a depth map's confidence, thickened where sparse; all black where the method has none."""
    confidence = np.zeros_like(depth.depth_m) if depth.confidence is None else depth.confidence
    valid = depth.valid & (depth.confidence is not None)
    picture = colour_confidence(confidence, valid)
    return Tile(thicken(picture) if depth.density < SPARSE else picture, "confidence", CONFIDENCE_BAR)


def panel(tiles: Sequence[Tile], columns: int = 2, tile_width: int = 828) -> Image:
    """Set captioned tiles side by side, each tile_width px wide; an empty place stays dark."""
    cells = [_cell(tile, tile_width) for tile in tiles]
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    heights = [max(cell.shape[0] for cell in row) for row in rows]
    width = min(columns, len(cells)) * (tile_width + GAP_PX) + GAP_PX
    canvas = np.full((sum(heights) + GAP_PX * (len(rows) + 1), width, 3), PAPER, np.uint8)
    top = GAP_PX
    for row, height in zip(rows, heights, strict=True):
        for i, cell in enumerate(row):
            left = GAP_PX + i * (tile_width + GAP_PX)
            canvas[top : top + cell.shape[0], left : left + tile_width] = cell
        top += height + GAP_PX
    return canvas


def _cell(tile: Tile, width: int) -> Image:
    """Draw a tile: the strip with caption and bar over the picture."""
    height = max(1, round(tile.picture.shape[0] * width / tile.picture.shape[1]))
    shrink = width < tile.picture.shape[1]
    picture = cv2.resize(tile.picture, (width, height), interpolation=cv2.INTER_AREA if shrink else cv2.INTER_NEAREST)
    strip = np.full((STRIP_PX, width, 3), PAPER, np.uint8)
    room = width - 8 if tile.bar is None else width - width // 3 - 60
    write(strip, tile.caption, (4, 22), scale=min(1.0, room / max(1, text_width(tile.caption))) * TEXT_SCALE)
    if tile.bar is not None:
        _draw_bar(strip, tile.bar, width)
    return np.concatenate([strip, picture])


def _draw_bar(strip: Image, bar: Bar, width: int) -> None:
    """Draw a bar into the right third of a strip."""
    length = width // 3
    left = width - length - 36
    at = np.arange(length) * len(bar.colours) // length
    strip[6:16, left : left + length] = bar.colours[at]
    for share, label in bar.ticks:
        x = left + round(share * (length - 1))
        strip[16:19, x] = FAINT
        write(strip, label, (x, 30), FAINT, 0.36, centred=True)


def write(
    canvas: Image,
    text: str,
    at: tuple[int, int],
    colour: Colour = INK,
    scale: float = TEXT_SCALE,
    centred: bool = False,
) -> None:
    """Write text on a picture, in place; at is the baseline's left end (x, y), or its middle."""
    if centred:
        at = (at[0] - text_width(text, scale) // 2, at[1])
    cv2.putText(canvas, text, at, FONT, scale, colour, 1, cv2.LINE_AA)


def text_width(text: str, scale: float = TEXT_SCALE) -> int:
    """Return how wide a text is drawn, px."""
    return int(cv2.getTextSize(text, FONT, scale, 1)[0][0])
