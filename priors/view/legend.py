"""Legend: what the colours of the points mean, as a picture for the view's panel."""

import cv2
import numpy as np

from priors.draw.panel import CONFIDENCE_BAR, FAINT, INK, PAPER, Bar, depth_bar, error_bar, write
from priors.types import Image
from priors.view.cloud import Colouring

WIDTH_PX, HEIGHT_PX, MARGIN_PX, BAR_PX = 300, 50, 20, 12
TITLES: dict[Colouring, str] = {
    "depth": "depth (camera z)",
    "error": "error, share of the truth (grey: no value)",
    "confidence": "confidence",
}


def legend(colouring: Colouring) -> Image | None:
    """Draw the colour bar of a colouring: (HEIGHT_PX, WIDTH_PX, 3); None for the image's own colours."""
    if colouring == "image":
        return None
    bar = {"depth": depth_bar(), "error": error_bar(), "confidence": CONFIDENCE_BAR}[colouring]
    return draw(bar, TITLES[colouring])


def draw(bar: Bar, title: str) -> Image:
    """Draw a bar under its title."""
    canvas = np.full((HEIGHT_PX, WIDTH_PX, 3), PAPER, np.uint8)
    write(canvas, title, (MARGIN_PX, 12), INK, 0.38)
    length = WIDTH_PX - 2 * MARGIN_PX
    row = bar.colours[None, np.arange(length) * len(bar.colours) // length]
    canvas[18 : 18 + BAR_PX, MARGIN_PX:-MARGIN_PX] = cv2.resize(row, (length, BAR_PX), interpolation=cv2.INTER_NEAREST)
    for share, label in bar.ticks:
        x = MARGIN_PX + round(share * (length - 1))
        canvas[18 + BAR_PX : 21 + BAR_PX, x] = FAINT
        write(canvas, label, (x, 44), INK, 0.33, centred=True)
    return canvas
