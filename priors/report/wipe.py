"""A wipe: two pictures of one frame, one over the other, and a divider between them that is dragged.

A reader chooses the frame and both sides. Maps are kept without loss, so that the colour under the pointer is read back
as metres, as a share or as a confidence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import cv2
import numpy as np

from priors import codecs
from priors.report.legend import Legend
from priors.report.page import data_url
from priors.selection import pick_middles
from priors.types import Image

JPEG_QUALITY = 85
"""Of photographs: 1240 px are then about 150 kB."""


@dataclass(frozen=True, slots=True)
class Layer:
    """One picture that a side can show."""

    source: str
    """Whose: the drive, a prior's or a run's name."""
    kind: str
    """What: a key of the wipe's kinds."""
    data: bytes
    media_type: str
    note: str = ""
    """What is said of it below the picture."""

    def __len__(self) -> int:
        return len(self.data)


@dataclass(frozen=True, slots=True)
class View:
    """One frame's pictures."""

    id: str
    layers: Sequence[Layer]

    @property
    def bytes(self) -> int:
        """Return how large its pictures are in a page: base64 writes three bytes as four."""
        return sum(map(len, self.layers)) * 4 // 3


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of picture."""

    label: str
    legend: Legend | None = None
    """What its colours mean; None for photographs."""


Side = tuple[str, str]
"""A source and a kind."""


@dataclass(frozen=True, slots=True)
class Wipe:
    """Frames to compare by a divider."""

    views: Sequence[View]
    size: tuple[int, int]
    """Height and width of the pictures, px."""
    kinds: Mapping[str, Kind]
    left: Side
    right: Side
    switch: Literal["source", "kind"]
    """What the row of buttons changes on both sides."""
    labels: Mapping[Side, str]
    """What to call a picture where it is not its kind's label."""
    remark: str = ""
    """Which frames are shown of how many."""
    template: ClassVar[str] = "wipe.html.j2"

    @property
    def sources(self) -> list[str]:
        """List whose pictures there are, in order."""
        return list(dict.fromkeys(layer.source for view in self.views for layer in view.layers))

    @property
    def sides(self) -> list[Side]:
        """List what a side can show, those of a source together."""
        found = dict.fromkeys((layer.source, layer.kind) for view in self.views for layer in view.layers)
        return sorted(found, key=lambda side: self.sources.index(side[0]))

    @property
    def used_kinds(self) -> dict[str, Kind]:
        """Return the kinds that there are pictures of."""
        used = {kind for _, kind in self.sides}
        return {key: kind for key, kind in self.kinds.items() if key in used}

    @property
    def buttons(self) -> list[str]:
        """List what the buttons choose: sources that have several kinds beside the first, or kinds of several sources.

        A single choice needs no button.
        """
        if self.switch == "source":
            found = self.sources[1:]
        else:
            found = [key for key in self.used_kinds if sum(kind == key for _, kind in self.sides) > 1]
        return found if len(found) > 1 else []

    def label(self, side: Side) -> str:
        """Return what a picture is called."""
        return self.labels.get(side, self.kinds[side[1]].label)

    def place(self, side: Side) -> int:
        """Return a side's number."""
        return self.sides.index(side)

    @property
    def content(self) -> dict[str, Any]:
        """Return what the page's script reads."""
        numbers = {side: number for number, side in enumerate(self.sides)}
        return {
            "sides": [
                {"source": source, "kind": kind, "name": f"{source}: {self.label((source, kind))}"}
                for source, kind in self.sides
            ],
            "readings": {
                key: dict(kind.legend.readings) for key, kind in self.used_kinds.items() if kind.legend is not None
            },
            "views": [
                {
                    "id": view.id,
                    "layers": {
                        numbers[layer.source, layer.kind]: [data_url(layer.data, layer.media_type), layer.note]
                        for layer in view.layers
                    },
                }
                for view in self.views
            ],
        }


def photograph(source: str, kind: str, image: Image, size: tuple[int, int], note: str = "") -> Layer:
    """Make the layer of a photograph, RGB or grey, shrunk to `size`."""
    data = codecs.encode_image(Path("a.jpg"), _resized(image, size, cv2.INTER_AREA), JPEG_QUALITY)
    return Layer(source, kind, data, "image/jpeg", note)


def coloured(source: str, kind: str, picture: Image, size: tuple[int, int], note: str = "") -> Layer:
    """Make the layer of a coloured map, RGB: every colour stays one of its legend's."""
    data = codecs.encode_lossless(_resized(picture, size, cv2.INTER_NEAREST))
    return Layer(source, kind, data, "image/webp", note)


def _resized(image: Image, size: tuple[int, int], interpolation: int) -> Image:
    if image.shape[:2] == size:
        return image
    return np.asarray(cv2.resize(image, size[::-1], interpolation=interpolation), np.uint8)


def shown_size(size: tuple[int, int], width_px: int) -> tuple[int, int]:
    """Return the size (height, width) in which pictures of a size are shown: at most so wide."""
    if size[1] <= width_px:
        return size
    return max(1, round(size[0] * width_px / size[1])), width_px


def fit_into(wipes: Sequence[Wipe], room: int) -> list[Wipe]:
    """Leave frames out, evenly, until the pictures take at most `room` bytes; one frame of each wipe always stays."""
    for most in range(max((len(wipe.views) for wipe in wipes), default=0), 0, -1):
        kept = [replace(wipe, views=pick_middles(wipe.views, most)) for wipe in wipes]
        if most == 1 or sum(view.bytes for wipe in kept for view in wipe.views) <= room:
            return kept
    return list(wipes)
