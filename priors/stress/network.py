"""A user's network on extreme images: whatever it is shown, its depth must be usable, or be refused in one line.

Stated of each input: a map of the image's size, in float32; finite, none below 0; a confidence, where there is one,
from 0 to 1, and 0 where there is no depth; the same bits when asked again. On a usual image some pixel has a depth.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from priors.errors import DataError
from priors.types import Camera, Depth, Frame, Image, Method

SHIFT_PX = 8
"""How far the right image of a made-up pair is shifted."""
KNOWN_M = 20.0
"""Depth of the pixels that are known: a network without a scale is aligned to them."""
BASELINE_M = 0.54
USUAL = "texture"


@dataclass(frozen=True)
class Tried:
    """What a network made of an input."""

    input: str
    fault: str = ""
    """What is wrong with the map; empty where it is as stated."""
    told: str = ""
    """The line in which it was refused."""
    density: float = 0.0
    """Share of the pixels that have a depth."""
    nearest_m: float | None = None
    farthest_m: float | None = None

    def record(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return asdict(self)


def texture(size: tuple[int, int]) -> Image:
    """Return an image with something to see at each place (height, width, 3)."""
    coarse = np.random.default_rng(0).integers(30, 220, (-(-size[0] // 6), -(-size[1] // 6), 3))
    fine = np.random.default_rng(1).integers(-25, 25, (*size, 3))
    return (coarse.repeat(6, 0).repeat(6, 1)[: size[0], : size[1]] + fine).clip(0, 255).astype(np.uint8)


def _plain(grey: int) -> Callable[[tuple[int, int]], Image]:
    return lambda size: np.full((*size, 3), grey, np.uint8)


def _one_pixel(size: tuple[int, int]) -> Image:
    image = np.zeros((*size, 3), np.uint8)
    image[size[0] // 2, size[1] // 2] = 255
    return image


def _checkers(size: tuple[int, int]) -> Image:
    row, column = np.indices(size)
    return np.repeat((255 * ((row + column) % 2))[..., None], 3, axis=2).astype(np.uint8)


INPUTS: tuple[tuple[str, Callable[[tuple[int, int]], Image]], ...] = (
    (USUAL, texture),
    ("black", _plain(0)),
    ("white", _plain(255)),
    ("constant grey", _plain(128)),
    ("noise", lambda size: np.random.default_rng(2).integers(0, 256, (*size, 3)).astype(np.uint8)),
    ("one bright pixel", _one_pixel),
    ("checkers of a pixel", _checkers),
    ("one channel", lambda size: np.ascontiguousarray(texture(size)[..., 0])),
)
"""Name of an input -> the image of a size."""


def try_network(
    method: Method, size: tuple[int, int], on_input: Callable[[str], None] = lambda name: None
) -> list[Tried]:
    """Put a network through all inputs.

    Args:
        method: runs it.
        size: (height, width) of the images, px.
        on_input: told the name of each input when it is done.

    Raises:
        DataError: the network cannot be opened, or not run on the usual image.
    """
    resolved = method.resolve(frame_of(texture(size)))
    found = []
    for name, make in INPUTS:
        frame = frame_of(make(size))
        try:
            first, again = resolved(frame), resolved(frame)
        except DataError as error:
            if name == USUAL:
                raise
            found.append(Tried(name, told=str(error)))
        else:
            found.append(_judge(name, first, again, size))
        on_input(name)
    return found


def frame_of(image: Image) -> Frame:
    """Return a frame of a made-up camera: the image, the same shifted as the other eye, and a few known depths."""
    height, width = image.shape[:2]
    K = np.array([[0.58 * width, 0, (width - 1) / 2], [0, 0.58 * width, (height - 1) / 2], [0, 0, 1]])
    known_m = np.zeros((height, width), np.float32)
    known_m[::4, ::4] = KNOWN_M * (1 + np.arange(width, dtype=np.float32)[None, ::4] / width)
    readers: dict[str, Callable[[], Any]] = {
        "image": lambda: image,
        "other": lambda: np.roll(image, -SHIFT_PX, axis=1),
        "sparse": lambda: Depth(known_m),
    }
    return Frame("000000", Camera(K, (height, width)), readers, baseline_m=BASELINE_M)


def _judge(name: str, depth: Depth, again: Depth, size: tuple[int, int]) -> Tried:
    depth_m, known = depth.depth_m, depth.valid
    fault = next((fault for fault, is_so in _faults(name, depth, again, size) if is_so()), "")
    if depth_m.shape != size or not known.any():
        return Tried(name, fault)
    return Tried(name, fault, "", depth.density, float(depth_m[known].min()), float(depth_m[known].max()))


def _faults(name: str, depth: Depth, again: Depth, size: tuple[int, int]) -> Sequence[tuple[str, Callable[[], bool]]]:
    """List what may be wrong with a map, and what tells it; those before hold when one is asked."""
    depth_m, trust = depth.depth_m, depth.confidence
    return (
        (f"the map is {depth_m.shape}, the image {size}", lambda: depth_m.shape != size),
        (f"the map holds {depth_m.dtype}, not float32", lambda: depth_m.dtype != np.float32),
        ("depths that are not finite", lambda: not np.isfinite(depth_m).all()),
        ("depths below 0", lambda: bool((depth_m < 0).any())),
        ("a confidence that is not from 0 to 1", lambda: trust is not None and not ((trust >= 0) & (trust <= 1)).all()),
        ("confidence where there is no depth", lambda: trust is not None and bool((trust[~depth.valid] > 0).any())),
        ("other bits when asked again", lambda: not np.array_equal(depth_m, again.depth_m)),
        ("no depth anywhere", lambda: name == USUAL and not depth.valid.any()),
    )
