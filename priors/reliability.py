"""Reliability of a prior: what its confidences state, beside the share of its values that is right.

for one in reliabilities(pair(prior, drive), preset("paper")):
    print(one.within, one.error)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eval.calibration import Tolerance
from eval.curves import Flat, scored_pixels
from eval.depth import Mask
from eval.protocol import Protocol
from eval.reliability import Reliability, reliability
from priors import methods
from priors.cache import Prior
from priors.error_model import WITHIN
from priors.held_back import is_held_back
from priors.records import restore
from priors.score import Pairs, fx_baseline_of
from priors.types import Depth, FloatMap


@dataclass(frozen=True, slots=True)
class Reading:
    """One of a map's probabilities."""

    within: Tolerance
    """What it is the probability of."""
    of: Callable[[Depth], FloatMap | None]


def readings(prior: Prior) -> list[Reading]:
    """Return the probabilities that a prior's maps state: the method's own, and that of 5 % where it is another."""
    found: list[Reading] = []
    if prior.method in methods.names():
        method = restore(methods.config_type(prior.method), prior.manifest.get("config", {}))
        if method.sure_within is not None:
            found.append(Reading(method.sure_within, lambda depth: depth.confidence))
    if all(reading.within != WITHIN for reading in found):
        found.append(Reading(WITHIN, lambda depth: depth.within_5_percent))
    return found


def reliabilities(pairs: Pairs, protocol: Protocol) -> list[Reliability]:
    """Compare each probability that a prior states with its errors, over the scored pixels of all frames.

    A reading that the maps do not have is left out; so is one in pixels where there is no pair.
    """
    found = readings(pairs.prior)
    stated: list[list[Flat]] = [[] for _ in found]
    right: list[list[Mask]] = [[] for _ in found]
    for depth, truth_m, fx_baseline in _maps(pairs):
        ready = protocol.prepare(depth.depth_m, truth_m)
        for number, reading in enumerate(found):
            chance = reading.of(depth)
            if chance is not None and (reading.within.unit != "px" or fx_baseline is not None):
                pixels = scored_pixels(ready, chance)
                stated[number].append(pixels.confidence)
                right[number].append(reading.within.within(pixels.prediction_m, pixels.truth_m, fx_baseline))
    return [
        reliability(np.concatenate(stated[number]), np.concatenate(right[number]), reading.within)
        for number, reading in enumerate(found)
        if stated[number]
    ]


def only_held_back(pairs: Pairs) -> Pairs:
    """Return the pairs of frames that no network of ours was trained on; none of them may be left."""
    return replace(pairs, ids=[id_ for id_ in pairs.ids if is_held_back(pairs.drive.name, id_)])


def _maps(pairs: Pairs) -> Iterator[tuple[Depth, FloatMap, float | None]]:
    """Read the maps that could be scored, their truth, and focal length times baseline, px m."""
    places = {frame_id: index for index, frame_id in enumerate(pairs.drive.ids)}
    for frame_id in pairs.ids:
        if frame_id not in pairs.left_out:
            frame = pairs.drive[places[frame_id]]
            truth = frame.truth() if pairs.against is None else pairs.against.read(frame_id)
            yield pairs.prior.read(frame_id), truth.depth_m, fx_baseline_of(frame)
