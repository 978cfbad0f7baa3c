"""A frame's comparison: image and truth on top, then a row a prior - depth, error against the truth, confidence."""

from collections.abc import Sequence

from priors.codecs import as_rgb
from priors.draw import panel
from priors.draw.panel import Tile
from priors.types import Depth, Frame, Image


def compare(frame: Frame, rows: Sequence[tuple[str, Depth]], width: int) -> Image:
    """Lay out one frame and its maps.

    Args:
        frame: the frame; its image, and its truth and the pair's other image where it has them.
        rows: name and map of each prior.
        width: of one tile, pixels.

    Returns:
        A picture, RGB. Tiles without anything to show are dark; the third column is there where a map has a confidence.
    """
    image = as_rgb(frame.image())
    truth = frame.truth() if frame.has("truth") else None
    dark = Tile(image * 0, "")
    tiles = [Tile(image, f"frame {frame.id}"), dark, dark]
    if truth is not None:
        tiles[1] = panel.depth_tile(truth, "truth")
    if frame.has("other"):
        tiles[2] = Tile(as_rgb(frame.other()), "the pair's other image")
    for name, depth in rows:
        tiles.append(panel.depth_tile(depth, name))
        tiles.append(dark if truth is None else panel.error_tile(depth, truth))
        tiles.append(dark if depth.confidence is None else panel.confidence_tile(depth))
    columns = 3 if any(depth.confidence is not None for _, depth in rows) else 2
    return panel.panel([tile for place, tile in enumerate(tiles) if place % 3 < columns], columns, width)
