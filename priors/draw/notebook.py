"""A depth map as a notebook shows it: its picture with a bar of metres, and its confidence beside."""

import base64
import html

from priors.codecs import encode_lossless
from priors.draw.panel import Tile, confidence_tile, depth_tile, panel
from priors.types import Depth

WIDTH_PX = 620
"""Of one picture; smaller maps are drawn larger."""


def depth_html(depth: Depth) -> str:
    """Return an HTML image of a map, with what its repr says as its text."""
    tiles: list[Tile] = [depth_tile(depth, "depth")]
    if depth.confidence is not None:
        tiles.append(confidence_tile(depth))
    coded = base64.b64encode(encode_lossless(panel(tiles, len(tiles), WIDTH_PX))).decode()
    told = html.escape(repr(depth))
    return f'<img alt="{told}" title="{told}" src="data:image/webp;base64,{coded}">'
