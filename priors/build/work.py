"""Work: the frames of a plan, computed in threads, shared with other builds of the same prior.

A frame is claimed while it is computed (priors/owner). One that another build has in hand is left to it, and looked at
again at the end: what the other one has not finished, because it was killed or failed, is computed here.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from priors.build.plan import CACHED, Judge
from priors.cache import Prior
from priors.cache.learned import ENTRY, DriveSources, keep
from priors.cache.sources import watch
from priors.errors import DataError
from priors.owner import claim
from priors.types import Depth, Drive, Frame

LOG = logging.getLogger(__name__)
CLAIMS = "claims"
POLL_S = 0.3
"""How often to look whether another build has finished a frame."""


@runtime_checkable
class MadeOfMaps(Protocol):
    """What makes a frame's depth of other maps in the cache."""

    def __call__(self, frame: Frame) -> Depth:
        """Make the frame's depth map."""
        ...

    def read_for(self, frame_id: str) -> DriveSources:
        """Return the files, by frame, that the maps were made of which a frame's map was made of."""
        ...


@dataclass
class Work:
    """Computes frames and notes what came of each."""

    drive: Drive
    prior: Prior
    judge: Judge
    make_depth: Callable[[Frame], Depth]
    """The method, and the filters after it."""
    on_frame: Callable[[str], None]
    """Told the id of each frame when it is done or has failed."""
    read_before: Callable[[str], DriveSources] = lambda frame_id: {}
    """Which files of any frame decided a frame's map besides those that were read for it: what the method learned from
    the drive, or what the maps were made of that it was made of."""
    built: list[dict[str, Any]] = field(default_factory=list)
    """The new lines of frames.jsonl."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""
    left: list[str] = field(default_factory=list)
    """Ids of the frames that another build has made meanwhile."""
    _in_other_hands: list[int] = field(default_factory=list)

    @property
    def claims(self) -> Path:
        """Return the folder of the prior's claims, a file for each frame in hand."""
        return self.prior.folder / CLAIMS

    def do(self, indices: Sequence[int], workers: int, on_note: Callable[[str], None]) -> None:
        """Compute frames; returns when each is done or has failed, here or elsewhere."""
        rounds = 0
        while indices:
            _run_each(self._do_one, indices, workers)
            indices, self._in_other_hands = self._in_other_hands, []
            rounds += 1
            if not indices or rounds == 1:  # most of those that were in hand are done by now
                continue
            if rounds == 2:
                owner = claim.owner_of(self.claims / self.drive.ids[indices[0]]) or "another build"
                on_note(f"waiting for {_frames(len(indices))} that {owner} has in hand")
            time.sleep(POLL_S)
        tidy(self.claims)

    def _do_one(self, index: int) -> None:
        frame_id = self.drive.ids[index]
        try:
            frame = self.drive[index]
            held = claim.take(self.claims / frame_id)
            if held is None:
                self._in_other_hands.append(index)
                return
            with held:
                self._compute(frame)
        except DataError as error:
            self.failed[frame_id] = str(error)
            LOG.debug("frame %s failed", frame_id, exc_info=True)
        self.on_frame(frame_id)

    def _compute(self, frame: Frame) -> None:
        if self.judge(frame).skip == CACHED:
            self.left.append(frame.id)
            LOG.info("frame %s: another build has made it", frame.id)
            return
        watched = watch(frame)
        start = time.perf_counter()
        depth = self.make_depth(watched.frame)
        seconds = time.perf_counter() - start
        LOG.info("frame %s: %.3f s", frame.id, seconds)
        learned = keep(self.prior.folder, self.read_before(frame.id))
        sources = watched.sources(self.judge.freshness.digests) | ({} if learned is None else {ENTRY: learned})
        self.built.append(self.prior.write(frame.id, depth, seconds, sources))


def tidy(claims: Path) -> None:
    """Delete the claims of builds that were killed, and their folder where no other build has a frame in hand."""
    with suppress(OSError):  # a cache that cannot be written keeps them
        for path in claims.glob("[!.]*"):
            if claim.is_dead(path) and (dead := claim.take(path)):
                dead.release()
        claims.rmdir()


def _frames(count: int) -> str:
    return "a frame" if count == 1 else f"{count} frames"


def _run_each(work: Callable[[int], None], indices: Sequence[int], workers: int) -> None:
    """Call work(index) for each, in threads, few in flight; an interrupt lets those in flight finish."""
    pending: set[Future[None]] = set()
    waiting: Iterator[int] = iter(indices)
    with ThreadPoolExecutor(workers) as pool:
        try:
            for index in waiting:
                pending.add(pool.submit(work, index))
                if len(pending) > workers:
                    done, pending = wait(pending, return_when=FIRST_COMPLETED)
                    _raise_first(done)
            _raise_first(wait(pending).done)
        except KeyboardInterrupt:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _raise_first(done: set[Future[None]]) -> None:
    for future in done:
        future.result()
