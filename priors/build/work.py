"""Work: the frames of a plan, computed in threads, shared with other builds of the same prior.

A frame is claimed while it is computed (priors/owner). One that another build has in hand is left to it, and looked at
again at the end: what the other one has not finished, because it was killed or failed, is computed here.
"""

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from priors.build.chains import Chains, Step
from priors.build.plan import CACHED, Judge
from priors.cache import Prior
from priors.cache.learned import ENTRY, DriveSources, keep
from priors.cache.sources import Sources, watch
from priors.errors import DataError
from priors.owner import claim
from priors.types import Depth, Earlier, Frame

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


@dataclass(frozen=True)
class Maker:
    """How a frame's map comes about."""

    whole: Callable[[Frame], Depth]
    carry_on: Callable[[Frame, Earlier], Depth | None]
    """Makes it of the map before; None where that fails."""
    filters: Callable[[Depth, Frame], Depth]

    def read_for(self, frame_id: str) -> DriveSources:
        """Return the files, by frame, that decided a frame's map through other maps in the cache."""
        return self.whole.read_for(frame_id) if isinstance(self.whole, MadeOfMaps) else {}


@dataclass
class Work:
    """Computes chains of frames and notes what came of each frame."""

    chains: Chains
    prior: Prior
    judge: Judge
    maker: Maker
    on_frame: Callable[[str], None]
    """Told the id of each frame when it is done or has failed."""
    learned: DriveSources = field(default_factory=dict)
    """What the method learned from the whole drive, for the record of each map."""
    built: list[dict[str, Any]] = field(default_factory=list)
    """The new lines of frames.jsonl."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""
    left: list[str] = field(default_factory=list)
    """Ids of the frames that another build has made meanwhile."""
    carried: list[str] = field(default_factory=list)
    """Ids of those of `built` that were made of the frame before."""
    _in_other_hands: list[int] = field(default_factory=list)

    @property
    def claims(self) -> Path:
        """Return the folder of the prior's claims, a file for each chain in hand, named by its first frame."""
        return self.prior.folder / CLAIMS

    def do(self, indices: Sequence[int], workers: int, on_note: Callable[[str], None]) -> None:
        """Compute frames; returns when each is done or has failed, here or elsewhere."""
        rounds = 0
        while indices:
            _run_each(self._do_chain, self.chains.group(indices), workers)
            indices, self._in_other_hands = self._in_other_hands, []
            rounds += 1
            if not indices or rounds == 1:  # most of those that were in hand are done by now
                continue
            if rounds == 2:
                owner = claim.owner_of(self.claims / self.chains.head(indices[:1])) or "another build"
                on_note(f"waiting for {_frames(len(indices))} that {owner} has in hand")
            time.sleep(POLL_S)
        tidy(self.claims)

    def _do_chain(self, chain: Sequence[int]) -> None:
        try:
            held = claim.take(self.claims / self.chains.head(chain))
        except DataError as error:
            for index in chain:
                self._fail(self.chains.drive.ids[index], error)
            return
        if held is None:
            self._in_other_hands.extend(chain)
            return
        with held:
            before = None
            for step in self.chains.steps(chain):
                before = self._do_step(step, before)

    def _do_step(self, step: Step, before: "Made | None") -> "Made | None":
        """Make a step's map, and write it where it is asked for; returns what the next step may be made of."""
        frame_id = self.chains.whole.ids[step.position]
        asked = step.index is not None
        made = None
        try:
            frame = self.chains.frame(step)
            done = asked and self.judge(frame).skip == CACHED
            if done:
                self.left.append(frame_id)
                LOG.info("frame %s: another build has made it", frame_id)
            if not done or self.chains.length > 1:
                made = self._make(frame, before, asked and not done)
        except DataError as error:
            if asked:
                self._fail(frame_id, error)
            return None
        if asked:
            self.on_frame(frame_id)
        return made

    def _make(self, frame: Frame, before: "Made | None", write: bool) -> "Made":
        watched = watch(frame)
        start = time.perf_counter()
        carried = None if before is None else self.maker.carry_on(watched.frame, before.earlier)
        depth = self.maker.whole(watched.frame) if carried is None else carried
        filtered = self.maker.filters(depth, watched.frame) if write else depth
        seconds = time.perf_counter() - start
        LOG.info("frame %s: %.3f s%s", frame.id, seconds, "" if carried is None else ", of the frame before")
        sources = watched.sources(self.judge.freshness.digests)
        made_before = self.maker.read_for(frame.id) | ({} if before is None else before.sources)
        if write:
            kept = keep(self.prior.folder, self.learned | made_before)
            beside: Sources = {} if kept is None else {ENTRY: kept}
            self.built.append(self.prior.write(frame.id, filtered, seconds, sources | beside))
            if carried is not None:
                self.carried.append(frame.id)
        return Made(Earlier(frame, depth), {**made_before, frame.id: sources})

    def _fail(self, frame_id: str, error: DataError) -> None:
        self.failed[frame_id] = str(error)
        LOG.debug("frame %s failed", frame_id, exc_info=error)
        self.on_frame(frame_id)


@dataclass(frozen=True)
class Made:
    """What was made of a step of a chain."""

    earlier: Earlier
    sources: DriveSources
    """Frame id -> the files that were read for it and for those before it in the chain."""


def tidy(claims: Path) -> None:
    """Delete the claims of builds that were killed, and their folder where no other build has a frame in hand."""
    with suppress(OSError):  # a cache that cannot be written keeps them
        for path in claims.glob("[!.]*"):
            if claim.is_dead(path) and (dead := claim.take(path)):
                dead.release()
        claims.rmdir()


def _frames(count: int) -> str:
    return "a frame" if count == 1 else f"{count} frames"


def _run_each(work: Callable[[Sequence[int]], None], chains: Sequence[Sequence[int]], workers: int) -> None:
    """Call work(chain) for each, in threads, few in flight; an interrupt lets those in flight finish."""
    pending: set[Future[None]] = set()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for chain in chains:
                pending.add(pool.submit(work, chain))
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
