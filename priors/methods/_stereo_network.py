"""Stereo matching by a network: what part of the pair it sees, at what scale, and its confidence."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from torch import Tensor

from priors.codecs import as_grey
from priors.methods._network import Network
from priors.methods._stereo_size import bring_image, bring_map, bring_mask, chance_in_pixels, count_halvings, seen_size
from priors.nets import runtime, weights
from priors.nets.confidence import ConfidenceCalibration
from priors.nets.export import Graph, Graphs
from priors.nets.surface_choice import SurfaceChoice
from priors.types import FloatMap, Image, Mask

Run = Callable[[Tensor, Tensor, int], tuple[FloatMap, FloatMap, FloatMap]]

RANGE_STEP_PX = 32
"""Networks search a multiple of this many disparities."""
HEADROOM = "headroom"
"""Entry of a header: how far beyond the scene's largest disparity the network searches; without it, no farther."""
LEAST_PX = 1e-3
"""Disparities are at least this, so that every pixel has a value."""
LEAST_CONTRAST = 2
"""Grey levels: rows and columns that vary less than this in both views hold nothing to match."""
_OPENING = threading.Lock()


@dataclass(frozen=True, slots=True)
class NetworkMatcher:
    """A stereo network that is ready to match."""

    run: Run
    """Called with the pair (1, 3, h, w), as `take` makes it, and the disparities to search; returns disparity,
    sigma (px) and doubt, each (h, w)."""
    calibration: ConfidenceCalibration
    headroom: float = 1.0
    """What the largest disparity that a scene needs is multiplied by: networks fail near the end of their search."""
    take: Callable[[Image], Tensor] = runtime.as_bytes
    """How an image becomes what `run` takes."""
    choice: SurfaceChoice | None = None
    """Chooses among the surfaces around a pixel where the network is unsure."""

    def __call__(
        self, left: Image, right: Image, max_disparity_px: int, sky: Mask | None = None, factor: float = 1.0
    ) -> tuple[FloatMap, FloatMap]:
        """Return the left view's disparity, px, 0 = none, and the probability that it is within 1 px (height, width).

        Of a pair that is halved, the pixel is one of the halved images.

        Args:
            left: (height, width, 3) or (height, width).
            right: the same.
            max_disparity_px: how far to search.
            sky: (height, width), True where the network has the last word; None: nowhere.
            factor: how many times larger the network sees the pair.
        """
        shape = left.shape[:2]
        disparity_px, confidence = np.zeros((2, *shape), np.float32)
        part = busy(left, right)
        left, right = left[part], right[part]
        if min(left.shape[:2]) == 0:
            return disparity_px, confidence
        halvings = count_halvings(left.shape[:2], max_disparity_px)
        size = seen_size(left.shape[:2], 0.5**halvings if halvings else factor, max_disparity_px)
        seen_left, seen_right = bring_image(left, size), bring_image(right, size)
        scale = left.shape[1] / size[1]
        largest_px = RANGE_STEP_PX * -(-(int(max_disparity_px / scale) + 1) // RANGE_STEP_PX)
        seen_px, sigma_px, doubt = self.run(self.take(seen_left), self.take(seen_right), largest_px)
        trust = self.calibration(seen_px, sigma_px, doubt)
        if self.choice is not None:
            apart = None if sky is None else bring_mask(sky[part], size)
            seen_px = self.choice((seen_px, sigma_px, doubt, trust), seen_left, apart)
        if not halvings:
            trust = chance_in_pixels(trust, 1 / scale)
        part_px = np.maximum(seen_px, np.float32(LEAST_PX)) * np.float32(scale)
        disparity_px[part], confidence[part] = (bring_map(map_, left.shape[:2]) for map_ in (part_px, trust))
        return disparity_px, confidence


def open_matcher(network: Network) -> NetworkMatcher:
    """Load a network, once a process; DataError where its weights are missing or damaged."""
    network, path = network.resolve(), network.file()
    with _OPENING:
        return _open(network, path, weights.digest(path))


@lru_cache(maxsize=16)
def _open(network: Network, path: Path, _digest: str) -> NetworkMatcher:
    if path.suffix == ".onnx":
        graph = Graph(path)
        calibration, choice = ConfidenceCalibration.read(graph.about), SurfaceChoice.read(graph.about)
        return NetworkMatcher(
            lambda left, right, largest_px: graph(left, right), calibration, take=runtime.as_input, choice=choice
        )
    chosen = network.decide()
    ready = runtime.open_net(network.model, network.size, chosen, path)
    calibration, headroom = ConfidenceCalibration.read(ready.about), float(ready.about.get(HEADROOM, 1.0))
    choice = SurfaceChoice.read(ready.about)
    if chosen == "onnx":
        return NetworkMatcher(Graphs(ready), calibration, headroom, runtime.as_input, choice)

    def run(left: Tensor, right: Tensor, largest_px: int) -> tuple[FloatMap, FloatMap, FloatMap]:
        out = ready(left, right, largest_px=largest_px)
        return runtime.as_map(out.disparity_px), runtime.as_map(out.sigma_px), runtime.as_map(out.doubt)

    return NetworkMatcher(run, calibration, headroom, choice=choice)


def busy(left: Image, right: Image) -> tuple[slice, slice]:
    """Return the rows and columns between the empty borders that rectification leaves: (rows, columns).

    Empty is what varies by less than two grey levels from its first to its last pixel in both views. Lines are looked
    at from the borders inwards, until one varies.
    """
    return _span(left, right), _span(left.swapaxes(0, 1), right.swapaxes(0, 1))


def _span(left: Image, right: Image) -> slice:
    """Return the slice from the first to the last line of a pair that varies; an empty one where none does."""

    def varies(line: int) -> bool:
        greys = (as_grey(np.ascontiguousarray(view[line : line + 1])) for view in (left, right))
        return any(int(grey.max()) - int(grey.min()) >= LEAST_CONTRAST for grey in greys)

    lines = left.shape[0] if left.size else 0
    first = next(filter(varies, range(lines)), lines)
    last = next(filter(varies, range(lines - 1, first - 1, -1)), first - 1)
    return slice(first, last + 1) if first < lines else slice(0, 0)
