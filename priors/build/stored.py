"""Maps that other maps are made of: read from the cache, and built where they are missing.

So what is made of them depends neither on the order of the frames nor on ranges and shards, and two builds never make
one map twice.
"""

import json
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from priors.build.job import Job
from priors.build.plan import CACHED
from priors.build.work import Work
from priors.cache.learned import ENTRY, FOLDER, DriveSources
from priors.error_model import within_5_percent
from priors.errors import DataError
from priors.types import Depth, Frame


@dataclass(frozen=True)
class StoredMaps:
    """The maps of a job's prior. Any thread may ask."""

    job: Job
    on_note: Callable[[str], None] = lambda line: None
    """Told what the method does before it makes its first map."""
    _locks: dict[str, threading.Lock] = field(default_factory=dict)
    _opening: threading.Lock = field(default_factory=threading.Lock)

    def read(self, index: int) -> Depth:
        """Return the map of the drive's frame at an index; DataError where there is none and none can be made."""
        frame_id = self.job.drive.ids[index]
        with self._locks.setdefault(frame_id, threading.Lock()):
            verdict = self.job.judge(self.job.drive[index])
            if verdict.skip not in (None, CACHED):
                raise DataError(f"frame {frame_id}: {self.job.method.name}: {verdict.skip}")
            if verdict.skip is None:
                self._make(index, frame_id)
            return self._with_5_percent(self.job.prior.read(frame_id), self.job.drive[index])

    def _with_5_percent(self, depth: Depth, frame: Frame) -> Depth:
        """Add the probability of 5 % to a map of the time before maps had it, where its confidence tells."""
        within = self.job.method.sure_within
        if depth.within_5_percent is not None or depth.confidence is None or within is None:
            return depth
        fx_baseline = None if frame.baseline_m is None else frame.camera.fx * frame.baseline_m
        return replace(depth, within_5_percent=within_5_percent(depth, within, fx_baseline))

    def read_for(self, frame_id: str) -> DriveSources:
        """Return the files, by frame, that a frame's map was made of; none where they are not known."""
        record = self.job.prior.journal.entry(frame_id).record or {}
        sources = record.get("made_of")
        if not isinstance(sources, dict):
            return {}
        own = {call: file for call, file in sources.items() if call != ENTRY}
        return merged(self._learned(sources.get(ENTRY)), {frame_id: own} if own else {})

    def _make(self, index: int, frame_id: str) -> None:
        with self._opening:
            work = self._work
        work.do([index], 1, self.on_note)
        if frame_id in work.failed:
            raise DataError(work.failed.pop(frame_id))

    @cached_property
    def _work(self) -> Work:
        return self.job.begin(lambda frame_id: None, self.on_note)

    def _learned(self, named: Any) -> DriveSources:
        """Return the list of files that a map's record names; none where there is none, or it is lost."""
        name = named.get("file") if isinstance(named, dict) else None
        if isinstance(name, str):
            with suppress(OSError, ValueError, RecursionError):
                read = json.loads((self.job.prior.folder / FOLDER / name).read_bytes())
                return read if isinstance(read, dict) else {}
        return {}


def merged(*parts: Mapping[str, Any]) -> DriveSources:
    """Join lists of files by frame."""
    joined: DriveSources = {}
    for part in parts:
        for frame_id, calls in part.items():
            joined[frame_id] = joined.get(frame_id, {}) | calls
    return joined
