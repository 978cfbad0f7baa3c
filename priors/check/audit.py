"""Audit a drive: what would spoil depth maps, found in seconds, one line a finding.

Poses, times and joins are looked at in every frame; images, sweeps and maps in a few frames spread over the drive.
"""

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, nullcontext
from typing import TypeAlias

from priors.check.calibration import judge_calibration
from priors.check.drift import judge_drift
from priors.check.extrinsics import judge_extrinsics
from priors.check.files import judge_files
from priors.check.finding import Finding
from priors.check.frames import judge_joins, open_frames
from priors.check.lidar import judge_lidar
from priors.check.maps import judge_maps
from priors.check.poses import judge_poses
from priors.check.sample import Sample
from priors.check.stereo import judge_stereo
from priors.check.times import judge_times
from priors.types import Drive, Frame

SAMPLES = 8
ProgressBar: TypeAlias = Callable[[str, int], AbstractContextManager[Callable[..., None]]]
"""Opens a progress bar of a label and a number of steps; yields what is called after each."""


def silent(label: str, count: int) -> AbstractContextManager[Callable[..., None]]:
    """Show no progress."""
    return nullcontext(lambda: None)


def check(drive: Drive, samples: int = SAMPLES, progress: ProgressBar = silent) -> list[Finding]:
    """Audit a drive; findings come in a fixed order, the worst level decides the exit code.

    Args:
        drive: any opened drive.
        samples: how many frames, spread over the drive, have their images, sweeps and maps read.
        progress: shows how far it is.
    """
    findings = list(judge_joins(drive))
    with progress("opening frames", len(drive)) as step:
        frames, broken = open_frames(drive, step)
    findings += broken
    if not frames:
        return findings
    sampled = look(frames, samples, progress)
    findings += judge_calibration(drive, frames[0])
    findings += judge_files(sampled)
    trusted = yield_into(findings, judge_stereo(sampled))
    for sample in sampled:
        sample.trusts_stereo = trusted
    maps = list(judge_maps(sampled))  # first: depth that they find wrong is no evidence for poses
    findings += judge_poses(frames, sampled)
    findings += judge_times(frames)
    by_lidar = list(judge_lidar(sampled))
    findings += by_lidar
    if trusted and all(finding.level != "fatal" for finding in by_lidar):
        findings += judge_extrinsics(sampled)
    others = [finding for finding in findings + maps if finding.subject not in ("frames", "times")]
    if all(finding.level in ("ok", "note") for finding in others):  # else they may be why flow is left over
        findings += judge_drift(drive, sampled)
    return findings + maps


def yield_into(findings: list[Finding], judge: Generator[Finding, None, bool]) -> bool:
    """Collect the findings of a judge; returns what it returns."""
    while True:
        try:
            findings.append(next(judge))
        except StopIteration as done:
            return bool(done.value)


def look(frames: list[Frame], samples: int, progress: ProgressBar) -> list[Sample]:
    """Read `samples` of the frames, spread evenly, and what their neighbours in time show of the same scene."""
    stride = max(1, -(-len(frames) // samples))
    places = list(range(stride // 2, len(frames), stride)) or [0]
    sampled = []
    with progress("reading sampled frames", len(places)) as step:
        for place in places:
            before, after = (frames[n] if 0 <= n < len(frames) else None for n in (place - 1, place + 1))
            sampled.append(Sample(frames[place], before, after))
            sampled[-1].look()
            step()
    return sampled
