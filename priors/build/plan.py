"""Plan: which frames of a drive a build computes, which it does not, and why."""

from dataclasses import dataclass, field

from priors.build.chains import Chains
from priors.cache import Prior
from priors.cache.learned import Freshness
from priors.cache.sources import Sources, restamped
from priors.errors import DataError
from priors.selection import MotionGate, Selection, select
from priors.types import Frame, Input

CACHED = "cached"
"""Why a frame that is done is skipped."""


@dataclass(frozen=True)
class Plan:
    """What a build will compute, and what it will not and why."""

    todo: list[int] = field(default_factory=list)
    """Indices into the drive."""
    skipped: dict[str, str] = field(default_factory=dict)
    """Frame id -> reason; frames outside the range or the shard are not listed."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> the one-line error of a frame that should be computed and cannot be read."""
    stale: dict[str, str] = field(default_factory=dict)
    """Frame id -> which file is not what its map was made of; they are in `todo`."""
    damaged: dict[str, str] = field(default_factory=dict)
    """Frame id -> what is wrong with its map; they are in `todo`."""
    restamped: dict[str, Sources] = field(default_factory=dict)
    """Id of a cached frame -> what its map was made of: the same files at other times, as copies have."""

    def add(self, index: int, frame: Frame, judge: "Judge") -> None:
        """Put a frame where it belongs."""
        verdict = judge(frame)
        if verdict.skip is not None:
            self.skipped[frame.id] = verdict.skip
            if verdict.restamped is not None:
                self.restamped[frame.id] = verdict.restamped
            return
        self.todo.append(index)
        if verdict.stale is not None:
            self.stale[frame.id] = verdict.stale
        if verdict.damaged is not None:
            self.damaged[frame.id] = verdict.damaged


@dataclass(frozen=True)
class Verdict:
    """Whether a frame is computed, and why."""

    skip: str | None = None
    """Why it is not computed; None: it is."""
    stale: str | None = None
    """Which file is not what its map was made of."""
    damaged: str | None = None
    """What is wrong with its map."""
    restamped: Sources | None = None
    """What its map was made of, where only the files' times are others."""


@dataclass(frozen=True)
class Judge:
    """Tells of a frame whether it must be computed, without reading maps where that can be."""

    prior: Prior
    reads: tuple[Input, ...]
    """What a frame must have to be computed."""
    distrust: bool
    """Whether maps count only after they were read: the folder's manifest was damaged or missing."""
    freshness: Freshness

    def __call__(self, frame: Frame) -> Verdict:
        """Judge a frame by what the journal and the file system say now."""
        damaged = self._why_damaged(frame)
        stale = None
        if damaged is None:
            record = self.prior.journal.entry(frame.id).record or {}
            sources = record.get("made_of")
            stale = self.freshness.why_stale(sources, frame)
            if stale is None:
                return Verdict(skip=CACHED, restamped=restamped(sources, frame))
        lacking = [what for what in self.reads if not frame.has(what)]
        if lacking and damaged is None:
            return Verdict(skip=CACHED)  # what it was made of is gone, and nothing better can be made
        if lacking:
            return Verdict(skip=frame.missing.get(lacking[0], f"no {lacking[0]}"))
        if not self.prior.depth_path(frame.id).exists():
            return Verdict()  # a new one
        return Verdict(stale=stale, damaged=damaged)

    def _why_damaged(self, frame: Frame) -> str | None:
        """Say why a frame is not done; None where it is."""
        why = self.prior.why_not_done(frame.id)
        marked = self.prior.journal.entry(frame.id).damaged is not None
        if marked or (why is None and self.distrust):
            try:
                self.prior.read(frame.id)  # it may have been put right
                return None
            except DataError as error:
                return why or str(error)
        return why


def make_plan(chains: Chains, selection: Selection, judge: Judge) -> Plan:
    """Choose the frames to compute; frames that are cached, still or lack an input are skipped with the reason."""
    plan, drive = Plan(), chains.drive
    gate = MotionGate(selection.min_motion)
    moving: dict[int, Frame] = {}
    for index in select(drive.ids, selection.frames):
        frame_id = drive.ids[index]
        try:
            frame = drive[index]
            if still := gate.reason(frame):
                plan.skipped[frame_id] = still
            else:
                moving[index] = frame
        except DataError as error:
            plan.failed[frame_id] = str(error)
    for index in chains.shard(list(moving), selection.shard):
        plan.add(index, moving[index], judge)
    return plan
