"""Rendered pictures: the files that keep what a field shows from one place.

renders/rgb/ID.png           8 bits, rounded
       /depth/ID.png         uint16, metres x 256, rounded, 0 = no value: where the field is clearer than OPAQUE
       /depth_colour/ID.png  the same for eyes
       /error/ID.jpg         image, render, colour error, depth and depth error with their bars
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eval.image import as_uint8
from nerf.types import RenderedView
from priors import codecs
from priors.draw.colours import GOOD_TO_BAD, colour_depth
from priors.draw.panel import Bar, Tile, depth_tile, error_tile, panel
from priors.types import Depth, Image

KEPT = ("rgb", "depth", "depth_colour", "error")
COLOUR_STEPS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Edges of the colour error's map, steps of 8 bits."""


def picture_path(renders: Path, kind: str, id_: str) -> Path:
    """Return where a frame's file of a kind (one of KEPT) is, or will be."""
    return renders / kind / f"{id_}{'.jpg' if kind == 'error' else '.png'}"


def save_view(renders: Path, id_: str, view: RenderedView) -> None:
    """Write a view's colour and depth files; values too far for 16 bits (256 m) become no value."""
    depth = view.solid()
    codecs.write_image(picture_path(renders, "rgb", id_), as_uint8(view.rgb))
    codecs.write_image(picture_path(renders, "depth_colour", id_), colour_depth(depth.depth_m))
    codecs.write_depth_png(picture_path(renders, "depth", id_), depth.depth_m)


def save_error(renders: Path, id_: str, view: RenderedView, image: Image, truth: Depth | None) -> None:
    """Write the panel that compares a view with the image and, where there is one, the true depth."""
    rgb, depth = as_uint8(view.rgb), view.solid()
    tiles = [
        Tile(image, f"image {id_}"),
        Tile(rgb, "render"),
        Tile(paint_colour_error(rgb, image), "colour error, steps of 8 bits", colour_error_bar()),
        depth_tile(depth, "depth"),
    ]
    if truth is not None:
        tiles += [depth_tile(truth, "true depth"), error_tile(Depth(view.depth_m), truth)]
    codecs.write_image(picture_path(renders, "error", id_), panel(tiles, tile_width=min(828, max(400, rgb.shape[1]))))


def load_view(renders: Path, id_: str) -> tuple[Image, Depth]:
    """Read what save_view wrote: colour, and depth where the field is opaque."""
    depth_m = codecs.read_depth_png(picture_path(renders, "depth", id_))
    return codecs.read_image(picture_path(renders, "rgb", id_)), Depth(depth_m)


def compare(id_: str, image: Image, truth: Depth | None, views: Sequence[tuple[str, Image, Depth]]) -> Image:
    """Lay out a frame: image and true depth, then colour, depth and depth error of each view, named by its run."""
    dark = Tile(image * 0, "")
    tiles = [Tile(image, f"image {id_}"), dark if truth is None else depth_tile(truth, "true depth"), dark]
    for name, rgb, depth in views:
        tiles += [Tile(rgb, name), depth_tile(depth, "depth"), dark if truth is None else error_tile(depth, truth)]
    used = 2 if truth is None else 3
    return panel([tile for i, tile in enumerate(tiles) if i % 3 < used], used, 480)


def paint_colour_error(rgb: Image, image: Image) -> Image:
    """Colour the root mean squared difference over the channels, in steps that double: blue is good, red is bad."""
    difference = rgb.astype(np.float64) - image
    return GOOD_TO_BAD[np.digitize(np.sqrt(np.mean(difference**2, axis=2)), COLOUR_STEPS)]


def colour_error_bar() -> Bar:
    """Make the bar of `paint_colour_error`."""
    steps = len(COLOUR_STEPS) + 1
    return Bar(GOOD_TO_BAD, [((i + 1) / steps, f"{step:g}") for i, step in enumerate(COLOUR_STEPS)])
