"""Scores on a Ray cluster: stretches of frames are scored where they lie, and their sums are merged."""

from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from types import ModuleType
from typing import Any

from eval.protocol import Protocol
from eval.result import Result
from eval.result import score as score_frames
from priors import cache, drives
from priors.cache import Prior
from priors.errors import DataError
from priors.scale.ray_session import Share
from priors.scale.tasks import run_tasks
from priors.score import OnFrame, Pairs

STRETCH = 16
"""Frames of a task."""


@dataclass(frozen=True)
class Stretch:
    """Frames of a prior to score in one process."""

    folder: Path
    drive: dict[str, Any]
    """What reopens the drive."""
    ids: list[str]
    against: Path | None
    protocol: Protocol
    fx_baseline: float | None


@dataclass(frozen=True)
class Scored:
    """What came of a stretch."""

    result: Result | None
    """None: no frame of it can be scored."""
    left_out: dict[str, str]


@dataclass(frozen=True)
class RayScorer:
    """Scores a prior's pairs on a cluster; what `score_pairs` takes in place of scoring here."""

    ray: ModuleType
    share: Share

    def __call__(self, pairs: Pairs, protocol: Protocol, info: dict[str, Any], on_frame: OnFrame) -> Result:
        """Score all pairs; frames that cannot be are noted in `pairs.left_out`.

        Raises:
            DataError: no frame can be scored.
        """
        against = None if pairs.against is None else _place(pairs.against)
        folder, drive, fx_baseline = _place(pairs.prior), pairs.drive.describe(), pairs.fx_baseline
        parts = [pairs.ids[first : first + STRETCH] for first in range(0, len(pairs.ids), STRETCH)]
        stretches = [Stretch(folder, drive, ids, against, protocol, fx_baseline) for ids in parts]
        results: dict[int, Result] = {}
        for done in run_tasks(self.ray, score_stretch, stretches, self.share):
            left = dict.fromkeys(parts[done.number], done.error) if done.made is None else done.made.left_out
            pairs.left_out.update(left)
            if done.made is not None and done.made.result is not None:
                results[done.number] = done.made.result
            for id_ in parts[done.number]:
                on_frame(id_)
        if not results:
            first, why = next(iter(pairs.left_out.items()))
            raise DataError(f"{pairs.prior.folder}: no frame can be scored, the first {first}: {why}")
        return replace(reduce(add, (results[number] for number in sorted(results))), info=info)


def score_stretch(stretch: Stretch) -> Scored:
    """Score frames in this process; DataError where the drive or the prior is not there."""
    against = None if stretch.against is None else cache.only(stretch.against)
    pairs = Pairs(cache.only(stretch.folder), drives.reopen(stretch.drive), stretch.ids, against)
    try:
        result = score_frames(pairs, stretch.protocol, stretch.fx_baseline)
    except DataError:
        if len(pairs.left_out) < len(stretch.ids):
            raise
        return Scored(None, pairs.left_out)
    return Scored(result, pairs.left_out)


def _place(prior: Prior) -> Path:
    """Return where all nodes find a prior."""
    if prior.store is None:
        return prior.folder.absolute()
    return Path(f"{prior.store.url}/{prior.folder.relative_to(prior.store.folder).as_posix()}")
