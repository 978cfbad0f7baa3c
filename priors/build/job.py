"""A job: a prior that can be built. `plan` says what a build will do, `run` does it."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from priors import cache
from priors.build import room
from priors.build.chains import Chains
from priors.build.decided import ENTRY
from priors.build.plan import Judge, Plan, make_plan
from priors.build.work import CLAIMS, MadeOfMaps, Maker, Work, tidy
from priors.cache import Prior
from priors.cache.learned import Freshness, WatchedDrive
from priors.cache.places import follow
from priors.cache.sources import Digests
from priors.cache.store import publish
from priors.errors import DataError, expect
from priors.filters import Filters
from priors.machine import threads
from priors.selection import Selection
from priors.types import Depth, Drive, Frame, Method

ALL = Selection()


@dataclass(frozen=True)
class BuildReport:
    """What a build did."""

    prior: Prior
    plan: Plan
    """What it was to do, with the reasons: frames that are cached, stale or damaged."""
    built: list[dict[str, Any]] = field(default_factory=list)
    """The new lines of frames.jsonl, in the order of their ids."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""
    left: list[str] = field(default_factory=list)
    """Ids of the frames of the plan that another build has made meanwhile."""
    carried: list[str] = field(default_factory=list)
    """Ids of those of `built` that were made of the frame before (`reuse`)."""


@dataclass(frozen=True)
class Job:
    """A prior that can be built: every 'auto' is decided and its folder is known; nothing is computed yet."""

    drive: Drive
    method: Method
    filters: Filters
    prior: Prior
    distrust: bool = False
    """Whether maps count only after they were read: the folder's manifest was damaged or missing."""
    reuse: int = 1
    """How many frames share one map that is made whole; 1: each has its own."""
    join: Callable[[Callable[[str], None]], MadeOfMaps] | None = None
    """Opens what makes a frame's map of others in the cache, told whom to tell notes; None: the method makes it."""

    @cached_property
    def chains(self) -> Chains:
        """The frames that are made together."""
        return Chains(self.drive, self.reuse)

    @cached_property
    def judge(self) -> Judge:
        """Tells of a frame whether it must be computed."""
        freshness = Freshness(self.prior.folder, self.chains.whole, Digests())
        return Judge(self.prior, (*self.method.reads, *self.filters.reads), self.distrust, freshness)

    def plan(self, selection: Selection = ALL) -> Plan:
        """Choose the frames to compute; frames that are cached, still or lack an input are skipped with the reason.

        Cached frames whose data has changed since, and damaged ones, are computed again.
        """
        return make_plan(self.chains, selection, self.judge)

    def run(
        self,
        plan: Plan | None = None,
        workers: int = 2,
        on_frame: Callable[[str], None] = lambda frame_id: None,
        on_note: Callable[[str], None] = lambda line: None,
    ) -> BuildReport:
        """Compute frames in threads and write each as soon as it is done.

        A frame that cannot be read is reported and the others go on. On KeyboardInterrupt the frames in hand are
        finished and written, the rest is left for the next run. What another build has in hand is left to it. The
        libraries' threads are held as the command holds them, so that a call is as fast beside other work.

        Args:
            plan: what to compute; default: every frame of the drive that is not cached.
            workers: frames computed at the same time.
            on_frame: told the id of each frame when it is done or has failed.
            on_note: told what the method does before the first frame, a line at a time.

        Raises:
            DataError: the cache's disk is too small.
        """
        expect(workers >= 1, "--workers", workers, "1 or more")
        plan = self.plan() if plan is None else plan
        self.restamp(plan)
        if not plan.todo:
            self.end()
            return BuildReport(self.prior, plan, failed=dict(plan.failed))
        self.expect_room(plan)
        for note in self.method.notes():
            on_note(note)
        with threads.limited(threads.count()):
            work = self.begin(on_frame, on_note)
            work.do(plan.todo, workers, on_note)
        built = sorted(work.built, key=lambda line: str(line["id"]))
        failed = {**plan.failed, **work.failed}
        return BuildReport(self.prior, plan, built, failed, sorted(work.left), sorted(work.carried))

    def expect_room(self, plan: Plan) -> None:
        """Raise DataError where the cache's disk is too small for the maps of a plan."""
        room.expect_room(self.prior, len(plan.todo))

    def begin(self, on_frame: Callable[[str], None], on_note: Callable[[str], None]) -> Work:
        """Make all ready for the first frame: what the method learns from the drive, and the prior's folder."""
        work = self.work(on_frame, on_note)
        self.make_folder()
        return work

    def work(
        self,
        on_frame: Callable[[str], None] = lambda frame_id: None,
        on_note: Callable[[str], None] = lambda line: None,
    ) -> Work:
        """Return what computes frames, in a folder that is made: what the method learns, and its network."""
        watched = WatchedDrive(self.drive)
        if self.join is not None:
            make_depth: Callable[[Frame], Depth] = self.join(on_note)
        else:
            make_depth = self.method.prepare(watched, self.prior.folder.parent / "weights", on_note)
        learned = watched.sources(self.judge.freshness.digests)
        maker = Maker(make_depth, self.method.carry_on, self.filters)
        return Work(self.chains, self.prior, self.judge, maker, on_frame, learned)

    def make_folder(self) -> None:
        """Make the prior's folder, and clear away what killed builds left; once a build, before its first frame."""
        cache.create(self.prior.folder, self.prior.manifest)
        follow(self.prior)
        self.prior.drop_stale()
        for path in (self.prior.folder.parent / "weights").glob("*.safetensors"):  # what adapted to the drive
            publish(path)

    def end(self) -> None:
        """Bring the manifest up to date where there is nothing to compute."""
        if self.prior.ids() and self._manifest_is_old():
            cache.create(self.prior.folder, self.prior.manifest)
            follow(self.prior)
        self._note_decided()
        tidy(self.prior.folder / CLAIMS)

    def restamp(self, plan: Plan) -> None:
        """Note the times of files that were copied, so that the next plan need not read them."""
        lines = self.prior.lines()
        with suppress(OSError):  # a cache that cannot be written: they are read each time
            for frame_id, sources in plan.restamped.items():
                self.prior.journal.append({**lines[frame_id], "made_of": sources})

    def _note_decided(self) -> None:
        """Keep what was measured in a manifest that lacks it; one of an earlier format stays as it is."""
        with suppress(DataError, OSError):  # a cache that cannot be written: it is measured each time
            there, own = cache.load(self.prior.folder).manifest, self.prior.manifest
            if ENTRY in own and there.get(ENTRY) != own[ENTRY] and there["format"] == own["format"]:
                cache.create(self.prior.folder, {**there, ENTRY: own[ENTRY]})

    def _manifest_is_old(self) -> bool:
        """Tell whether the manifest must be written though no map is made: the drive has moved, or it is damaged."""
        try:
            return cache.load(self.prior.folder).drive != self.prior.drive
        except DataError:
            return True
