"""Build a prior: drive x method x filters -> cache. What is there already is not made again.

From Python:

    job = build.prepare(open_drive(Path("street")), Stereo())
    prior = job.run().prior

`priors build` does the same, and prints what `Job.plan` says between the two.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from priors import cache, keys
from priors.cache import Prior
from priors.errors import DataError, expect
from priors.filters import Filters
from priors.machine import threads
from priors.records import record
from priors.selection import MotionGate, Selection, select, shard
from priors.sky import VERSION as SKY_VERSION
from priors.types import Drive, Frame, Input, Method

ALL = Selection()


@dataclass(frozen=True)
class Plan:
    """What a build will compute, and what it will not and why."""

    todo: list[int]
    """Indices into the drive."""
    skipped: dict[str, str]
    """Frame id -> reason; frames outside the range or the shard are not listed."""
    failed: dict[str, str]
    """Frame id -> the one-line error of a frame that should be computed and cannot be read."""


@dataclass(frozen=True)
class BuildReport:
    """What a build did."""

    prior: Prior
    plan: Plan
    built: list[dict[str, Any]] = field(default_factory=list)
    """The new lines of frames.jsonl, in the order of their ids."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""


@dataclass(frozen=True)
class Job:
    """A prior that can be built: every 'auto' is decided and its folder is known; nothing is computed yet."""

    drive: Drive
    method: Method
    filters: Filters
    prior: Prior

    def plan(self, selection: Selection = ALL) -> Plan:
        """Choose the frames to compute; frames that are cached, still or lack an input are skipped with the reason."""
        todo: list[int] = []
        skipped: dict[str, str] = {}
        failed: dict[str, str] = {}
        gate = MotionGate(selection.min_motion)
        moving = []
        for index in select(self.drive.ids, selection.frames):
            frame_id = self.drive.ids[index]
            try:
                frame = self.drive[index]
                if still := gate.reason(frame):
                    skipped[frame_id] = still
                else:
                    moving.append((index, frame))
            except DataError as error:
                failed[frame_id] = str(error)
        for index, frame in shard(moving, selection.shard):
            if reason := self._skip(frame):
                skipped[frame.id] = reason
            else:
                todo.append(index)
        return Plan(todo, skipped, failed)

    def _skip(self, frame: Frame) -> str | None:
        """Return why a frame is not computed, or None."""
        if self.prior.has(frame.id):
            return "cached"
        lacking = [what for what in (*self.method.reads, *self.filters.reads) if not frame.has(what)]
        return frame.missing.get(lacking[0], f"no {lacking[0]}") if lacking else None

    def run(
        self,
        plan: Plan | None = None,
        workers: int = 2,
        on_frame: Callable[[str], None] = lambda frame_id: None,
        on_note: Callable[[str], None] = lambda line: None,
    ) -> BuildReport:
        """Compute frames in threads and write each as soon as it is done.

        A frame that cannot be read is reported and the others go on. On KeyboardInterrupt the frames in hand are
        finished and written, the rest is left for the next run. The libraries' threads are held as the command holds
        them, so that a call is as fast beside other work.

        Args:
            plan: what to compute; default: every frame of the drive that is not cached.
            workers: frames computed at the same time.
            on_frame: told the id of each frame when it is done or has failed.
            on_note: told what the method does before the first frame, a line at a time.
        """
        expect(workers >= 1, "--workers", workers, "1 or more")
        plan = self.plan() if plan is None else plan
        report = BuildReport(self.prior, plan, failed=dict(plan.failed))
        if not plan.todo and self.prior.ids() and cache.load(self.prior.folder).drive != self.prior.drive:
            cache.create(self.prior.folder, self.prior.manifest)  # the drive has moved
        if plan.todo:
            for note in self.method.notes():
                on_note(note)
            with threads.limited(threads.count()):
                self._build(report, workers, on_frame, on_note)
        return report

    def _build(
        self, report: BuildReport, workers: int, on_frame: Callable[[str], None], on_note: Callable[[str], None]
    ) -> None:
        """Compute what the report's plan says, and note in the report what came of it."""
        make_depth = self.method.prepare(self.drive, self.prior.folder.parent / "weights", on_note)
        cache.create(self.prior.folder, self.prior.manifest)
        self.prior.drop_stale()
        writing = threading.Lock()

        def build_frame(index: int) -> None:
            frame_id = self.drive.ids[index]
            try:
                frame = self.drive[index]
                start = time.perf_counter()
                depth = self.filters(make_depth(frame), frame)
                seconds = time.perf_counter() - start
                with writing:  # frames.jsonl gets whole lines
                    report.built.append(self.prior.write(frame_id, depth, seconds))
            except DataError as error:
                report.failed[frame_id] = str(error)
            on_frame(frame_id)

        _run_each(build_frame, report.plan.todo, workers)
        report.built.sort(key=lambda line: line["id"])


def prepare(drive: Drive, method: Method, filters: Filters | None = None, folder: Path = Path("cache")) -> Job:
    """Decide every 'auto' and find the prior's place in the cache; no map is made.

    Args:
        drive: what to make depth for.
        method: how; 'auto' is decided on the drive's first frame.
        filters: what to leave out of the maps; default: nothing.
        folder: the cache.
    """
    filters = filters or Filters()
    frame = _first_readable(drive)
    method = method.resolve(frame)
    manifest = {
        "format": cache.FORMAT,
        "code": version("roadprior"),
        "method": method.name,
        "version": method.VERSION,
        "config": record(method),
        "filters": filters.record(),
        "sky": SKY_VERSION,
        "weights": method.weights_digest(),
        "fingerprint": drive.fingerprint(),
        "maps": _maps_digest(frame, {*method.reads, *filters.reads}),
        "camera": {"K": frame.camera.K.tolist(), "size": list(frame.camera.size), "baseline_m": frame.baseline_m},
        "encoding": "kitti",
        "drive": {"name": drive.name, **drive.describe()},
    }
    earlier = keys.find(folder / drive.name, manifest, type(method))
    key = keys.key(manifest, type(method)) if earlier is None else earlier.manifest["key"]
    home = folder / drive.name / f"{method.name}-{key}" if earlier is None else earlier.folder
    return Job(drive, method, filters, Prior(home, {**manifest, "key": key}))


def _first_readable(drive: Drive) -> Frame:
    """Return the first frame that can be opened; the last error where none can."""
    reason = DataError(f"{drive.name}: no frames")
    for index in range(len(drive)):
        try:
            return drive[index]
        except DataError as error:
            reason = error
    raise reason


def _maps_digest(frame: Frame, reads: set[Input]) -> str | None:
    """Hash the first depth map that the method or a filter reads (--truth may name other maps for the same drive)."""
    maps = [frame.read(what) for what in sorted(reads & {"sparse", "truth"}) if frame.has(what)]
    return sha256(b"".join(depth.depth_m.tobytes() for depth in maps)).hexdigest() if maps else None


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
