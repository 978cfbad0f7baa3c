"""What stereo networks are trained and validated on, drawn from the street, warped images and labelled real pairs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from priors.learn.pair import Item, from_street, to_item
from priors.learn.scans import Streets
from priors.learn.vary import Variation, vary

Draw = Callable[[np.random.Generator], Item]


def mixture(street: Path, crop: tuple[int, int] = (256, 512), variation: Variation = Variation()) -> Draw:
    """Return what draws a training item (see pair.to_item); the item follows from the generator's state alone."""
    paths = Streets(street).train

    def draw(rng: np.random.Generator) -> Item:
        return to_item(vary(from_street(paths[rng.integers(len(paths))]), rng, crop, variation))

    return draw


def validation(street: Path, count: int = 24) -> list[Item]:
    """Return items of worlds that `mixture` never draws from, whole and unvaried."""
    paths = Streets(street).validation
    chosen = paths[:: max(1, len(paths) // count)][:count]
    return [to_item(from_street(path)) for path in chosen]
