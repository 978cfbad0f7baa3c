"""Build a prior: drive x method x filters -> cache. What is there already is not made again."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from priors import cache, keys
from priors.cache import Prior
from priors.errors import DataError
from priors.filters import Filters
from priors.records import record
from priors.sky import VERSION as SKY_VERSION
from priors.types import Depth, Drive, Frame, Method

LARGEST_FRAME_NUMBER = 10**7


@dataclass(frozen=True)
class Selection:
    """Which frames of a drive to work on."""

    frames: str | None = None
    """Range a:b of frame numbers as in the file names, b not included (5:17 is 0000000005 to 0000000016); of
    positions where the file names are no frame numbers. Default: all."""
    shard: str | None = None
    """i/n with 1 <= i <= n: every n-th frame from the i-th on, so that n machines share a drive."""
    min_motion: float = 0.0
    """Skip frames in which the camera moved less than this since the last one kept, metres; 0 = keep all."""


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
class Report:
    """What a build did."""

    prior: Prior
    plan: Plan
    built: list[dict[str, Any]] = field(default_factory=list)
    """The new lines of frames.jsonl."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""


def prepare(drive: Drive, method_name: str, method: Method, filters: Filters, folder: Path) -> tuple[Prior, Method]:
    """Decide every 'auto' and open the prior's place in the cache; no map is made.

    Returns:
        The prior, and the method with its config resolved.
    """
    frame = _first_readable(drive)
    method = method.resolve(frame)
    manifest = {
        "format": cache.FORMAT,
        "code": version("roadprior"),
        "method": method_name,
        "version": method.VERSION,
        "config": record(method),
        "filters": filters.record(),
        "sky": SKY_VERSION,
        "weights": _weights_digest(method),
        "fingerprint": drive.fingerprint(),
        "maps": _maps_digest(frame, {*method.reads, *filters.reads}),
        "camera": {"K": frame.camera.K.tolist(), "size": list(frame.camera.size), "baseline_m": frame.baseline_m},
        "encoding": "kitti",
        "drive": {"name": drive.name, **drive.describe()},
    }
    earlier = keys.find(folder / drive.name, manifest, type(method))
    key = keys.key(manifest, type(method)) if earlier is None else earlier.manifest["key"]
    home = folder / drive.name / f"{method_name}-{key}" if earlier is None else earlier.folder
    return Prior(home, {**manifest, "key": key}), method


def plan(drive: Drive, prior: Prior, reads: Sequence[str], selection: Selection) -> Plan:
    """Choose the frames to compute; frames that are cached, still or lack an input are skipped with the reason."""
    todo: list[int] = []
    skipped: dict[str, str] = {}
    failed: dict[str, str] = {}
    chosen = select(drive.ids, selection.frames)
    moved = _MotionGate(selection.min_motion)
    kept = []
    for index in chosen:
        frame_id = drive.ids[index]
        try:
            frame = drive[index]
            if still := moved.reason(frame):
                skipped[frame_id] = still
            else:
                kept.append((index, frame))
        except DataError as error:
            failed[frame_id] = str(error)
    for index, frame in shard(kept, selection.shard):
        lacking = [what for what in reads if not frame.has(what)]
        if prior.has(frame.id):
            skipped[frame.id] = "cached"
        elif lacking:
            skipped[frame.id] = frame.missing.get(lacking[0], f"no {lacking[0]}")
        else:
            todo.append(index)
    return Plan(todo, skipped, failed)


def build(
    drive: Drive,
    prior: Prior,
    method: Method,
    filters: Filters,
    plan_: Plan,
    workers: int = 2,
    on_frame: Callable[[str], None] = lambda frame_id: None,
    on_note: Callable[[str], None] = lambda line: None,
) -> Report:
    """Compute the planned frames in threads and write each as soon as it is done.

    A method that needs the whole drive first has a `prepare(drive, folder, on_note)`, called once; it returns what
    makes a frame's depth and may keep what it learned in the folder. What it does is told to on_note, a line at a time.

    A frame that cannot be read is reported and the others go on. On KeyboardInterrupt the frames in hand are finished
    and written, the rest is left for the next run.
    """
    if not plan_.todo:
        return Report(prior, plan_, failed=dict(plan_.failed))
    make: Callable[[Frame], Depth] = method
    if hasattr(method, "prepare"):
        make = method.prepare(drive, prior.folder.parent / "weights", on_note)
    cache.create(prior.folder, prior.manifest)
    prior.drop_stale()
    report = Report(prior, plan_, failed=dict(plan_.failed))
    writing = threading.Lock()

    def one(index: int) -> None:
        frame_id = drive.ids[index]
        try:
            frame = drive[index]
            start = time.perf_counter()
            depth = filters(make(frame), frame)
            seconds = time.perf_counter() - start
            with writing:  # frames.jsonl gets whole lines
                report.built.append(prior.write(frame_id, depth, seconds))
        except DataError as error:
            report.failed[frame_id] = str(error)
        on_frame(frame_id)

    _run(one, plan_.todo, workers)
    report.built.sort(key=lambda line: line["id"])
    return report


def select(ids: Sequence[str], frames: str | None) -> list[int]:
    """Return the indices of the frames in a range a:b (see Selection.frames)."""
    if frames is None:
        return list(range(len(ids)))
    first, colon, last = frames.partition(":")
    numeric = all(id_.isdigit() and int(id_) < LARGEST_FRAME_NUMBER for id_ in ids)
    numbers = [int(id_) for id_ in ids] if numeric else list(range(len(ids)))
    try:
        low = int(first) if first else 0
        high = (int(last) if last else LARGEST_FRAME_NUMBER) if colon else low + 1
    except ValueError as error:
        raise DataError(f"--frames {frames}: expected a:b, for example 5:17") from error
    chosen = [index for index, number in enumerate(numbers) if low <= number < high]
    if not chosen:
        raise DataError(f"--frames {frames}: no frames there; the drive has {numbers[0]}:{numbers[-1] + 1}")
    return chosen


def shard(items: list[Any], text: str | None) -> list[Any]:
    """Return every n-th item from the i-th on, for i/n; everything for None."""
    if text is None:
        return items
    try:
        part, count = (int(word) for word in text.split("/"))
    except ValueError as error:
        raise DataError(f"--shard {text}: expected i/n, for example 1/4") from error
    if not 1 <= part <= count:
        raise DataError(f"--shard {text}: i goes from 1 to n")
    return items[part - 1 :: count]


class _MotionGate:
    """Remembers the last kept position, to find frames in which the camera stood still."""

    def __init__(self, min_motion_m: float) -> None:
        self.min_motion_m = min_motion_m
        self.last: np.ndarray | None = None

    def reason(self, frame: Frame) -> str | None:
        """Return why the frame is to be skipped, or None."""
        if self.min_motion_m <= 0:
            return None
        if frame.T_world_cam is None:
            raise DataError(f"frame {frame.id}: --min-motion needs poses, this drive has none: leave it out")
        position = frame.T_world_cam[:3, 3]
        if self.last is not None:
            moved_m = float(np.linalg.norm(position - self.last))
            if moved_m < self.min_motion_m:
                return f"stood still: moved {moved_m:.2f} m"
        self.last = position
        return None


def _first_readable(drive: Drive) -> Frame:
    """Return the first frame that can be opened; the last error where none can."""
    error = DataError(f"{drive.name}: no frames")
    for index in range(len(drive)):
        try:
            return drive[index]
        except DataError as found:
            error = found
    raise error


def _weights_digest(method: Method) -> str | None:
    """Return the hash of a method's learned weights; None where it has none."""
    offered: Callable[[], str | None] | None = getattr(method, "weights_digest", None)
    return offered() if offered else None


def _maps_digest(frame: Frame, reads: set[str]) -> str | None:
    """Hash the first depth map that the method or a filter reads (--truth may name other maps for the same drive)."""
    maps = [frame.read(what) for what in sorted(reads & {"sparse", "truth"}) if frame.has(what)]
    return sha256(b"".join(depth.depth_m.tobytes() for depth in maps)).hexdigest() if maps else None


def _run(one: Callable[[int], None], todo: Sequence[int], workers: int) -> None:
    """Call one(index) for each, in threads, few in flight; an interrupt lets those in flight finish."""
    pending: set[Future[None]] = set()
    waiting: Iterator[int] = iter(todo)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        try:
            for index in waiting:
                pending.add(pool.submit(one, index))
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
