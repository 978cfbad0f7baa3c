"""Extrinsics: is the LiDAR turned against the camera as calibrated, and as late?"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.errors import DataError
from priors.extrinsics.measure import FEWEST_FRAMES, measure
from priors.types import Frame, Input

KINDS: tuple[Input, ...] = ("image", "other", "sweep")
MEND = "--lidar.extrinsics measured corrects it"


def judge_extrinsics(sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Measure turn and delay on the sampled frames; nothing where few of them have a LiDAR."""
    frames = [frame for frame in map(_as_read, sampled) if frame is not None]
    if len(frames) < FEWEST_FRAMES:
        return
    try:
        measured = measure(frames)
    except DataError as error:
        yield Finding("note", "lidar", f"its turn against the camera is not measured: {error}")
        return
    if measured.is_off:
        yield Finding("warning", "lidar", f"against the camera it is {measured}: {MEND}")
    else:
        yield Finding("ok", "lidar", f"against the camera it is {measured}")


def _as_read(sample: Sample) -> Frame | None:
    """Return the sample's frame without reading its files again; None where it has no LiDAR, image or sweep."""
    read = {what: sample.read(what) for what in KINDS}
    if sample.frame.T_cam_lidar is None or read["image"] is None or read["sweep"] is None:
        return None
    readers: dict[str, Callable[..., Any]] = {
        what: partial(_give, found) for what, found in read.items() if found is not None
    }
    return replace(sample.frame, readers=readers)


def _give(found: Any, offset: int = 0) -> Any:
    """Return what was read, as a frame's reader does."""
    return found
