"""The flicker of a prior over a drive: how its depth of one point differs from frame to frame (eval/flicker.py)."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from eval.flicker import View, flicker
from priors.cache import Prior
from priors.errors import DataError
from priors.motion import trajectory
from priors.types import Drive


def flicker_of(prior: Prior, drive: Drive, ids: Sequence[str], against: Prior | None = None) -> float:
    """Return the mean flicker over the pairs of neighbouring frames, a share of the depth.

    Args:
        prior: whose maps.
        drive: the one that the prior was made for.
        ids: frames that have both a map and a truth.
        against: another prior in place of the drive's truth.

    Raises DataError where frames have no poses, where no two neighbours have both, and where nothing of them can be
    compared.
    """
    places = {id_: index for index, id_ in enumerate(drive.ids)}
    chosen = sorted(ids, key=places.__getitem__)
    path = trajectory(drive)
    pairs = [
        (one, next_)
        for one, next_ in pairwise(chosen)
        if places[next_] == places[one] + 1 and not path.broken(one, next_)
    ]
    if not pairs:
        raise DataError(f"{prior.folder}: --temporal compares neighbouring frames: no two of them have a map and truth")
    views: dict[str, View] = {}
    found = []
    for one, next_ in pairs:
        views = {id_: views.get(id_) or _view(prior, drive, places[id_], against) for id_ in (one, next_)}
        found.append(flicker(views[one], views[next_]))
    known = [value for value in found if not np.isnan(value)]
    if not known:
        raise DataError(f"{prior.folder}: --temporal: no point with truth is seen by two neighbouring frames")
    return float(np.mean(known))


def _view(prior: Prior, drive: Drive, index: int, against: Prior | None) -> View:
    """Read what the flicker needs of a frame."""
    frame = drive[index]
    if frame.T_world_cam is None and "pose" not in frame.missing:
        raise DataError(f"{drive.name}: --temporal compares frames by their poses, and it has none: `priors poses`")
    truth = frame.truth() if against is None else against.read(frame.id)
    return View(prior.read(frame.id).depth_m, truth.depth_m, frame.camera.K, frame.pose())
