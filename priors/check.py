"""Audit a drive: what would spoil depth maps, found in seconds, one line a finding.

Poses, times and joins are looked at in every frame; images, sweeps and maps in a few frames spread over the drive.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.pairs.agreement import compare_sweep, match_corners
from priors.types import Drive, Frame

Level = Literal["ok", "note", "warning", "fatal"]

SAMPLES = 8
JUMP, JUMP_M = 3.0, 0.5  # times the speed around, and at least this much farther
STILL_M = 0.02
FASTEST_M_S = 70.0
OFF_ROW_PX, BAD_ROW_PX = 0.5, 2.0  # vertical offset of the pair
LIDAR_PX, LIDAR_OFF, LIDAR_BAD = 2.0, 0.1, 0.2  # disparity, share of the depth, share that is fatal


@dataclass(frozen=True)
class Finding:
    """One line of the audit."""

    level: Level
    """ok; note: missing, and fine if not needed; warning: look at it; fatal: maps would be wrong or not made."""
    subject: str
    """calibration, frames, files, stereo, poses, times, lidar or truth."""
    message: str
    """What was found and, where it is wrong, what to do."""


@runtime_checkable
class Listed(Protocol):
    """A drive that can say, without reading files, which scans it has."""

    def scans(self) -> Mapping[str, Sequence[str]]:
        """Map sensor (image, other, sweep, pose) to the frame ids it has."""
        ...


def check(drive: Drive, samples: int = SAMPLES) -> list[Finding]:
    """Audit a drive; findings come in a fixed order, the worst level decides the exit code.

    Args:
        drive: any opened drive.
        samples: how many frames, spread over the drive, have their images, sweeps and maps read.
    """
    findings = list(_joins(drive))
    frames, broken = _index(drive)
    findings += broken
    if not frames:
        return findings
    step = max(1, -(-len(frames) // samples))
    sampled = frames[step // 2 :: step] or frames[:1]
    parts: tuple[tuple[Callable[[list[Frame]], Iterator[Finding]], list[Frame]], ...] = (
        (_calibration, frames), (_files, sampled), (_stereo, sampled), (_poses, frames), (_times, frames),
        (_lidar, sampled),
    )  # fmt: skip
    for part, over in parts:
        findings += part(over)
    return findings


def _joins(drive: Drive) -> Iterator[Finding]:
    """Gaps in the frame ids, and sensors that lack some of them."""
    yield Finding("ok", "frames", f"{len(drive)} frames, {drive.ids[0]} to {drive.ids[-1]}")
    gaps = _gaps(drive.ids)
    if gaps:
        yield Finding("note", "frames", f"{len(gaps)} gaps in the ids: {_some(gaps)}")
    if not isinstance(drive, Listed):
        return
    for what, ids in drive.scans().items():
        lacking = sorted(set(drive.ids) - set(ids))
        if ids and lacking:
            yield Finding("warning", "frames", f"{len(lacking)} frames have no {what}: {_some(lacking)}")


def _gaps(ids: Sequence[str]) -> list[str]:
    """Return where frame numbers that mostly count by one do not; nothing for other ids (times, names)."""
    if not all(id_.isdecimal() for id_ in ids) or len(ids) < 3:
        return []
    steps = np.diff([int(id_) for id_ in ids])
    if np.median(steps) != 1:
        return []
    return [f"{ids[n]}..{ids[n + 1]}" for n in np.flatnonzero(steps > 1).tolist()]


def _index(drive: Drive) -> tuple[list[Frame], list[Finding]]:
    """Open every frame, which reads its pose; count those that cannot be."""
    frames, errors = [], []
    for index in range(len(drive)):
        try:
            frames.append(drive[index])
        except DataError as error:
            errors.append(str(error))
    if not errors:
        return frames, []
    return frames, [Finding("fatal", "frames", f"{len(errors)} frames cannot be opened, the first: {errors[0]}")]


def _calibration(frames: list[Frame]) -> Iterator[Finding]:
    """Is this a camera, and a pair, that a car would carry?"""
    frame = frames[0]
    (height, width), K = frame.camera.size, frame.camera.K
    angle = float(np.degrees(2 * np.arctan(0.5 * width / K[0, 0])))
    shown = f"{width}x{height}, focal length {K[0, 0]:.1f} px ({angle:.0f} degrees)"
    centred = 0.25 < K[0, 2] / width < 0.75 and 0.25 < K[1, 2] / height < 0.75
    if not centred:
        centre = f"centre ({K[0, 2]:.0f}, {K[1, 2]:.0f}) far from the middle"
        yield Finding("fatal", "calibration", f"{shown}, {centre}: were images or calibration resized or cropped?")
    elif not 15 < angle < 140 or not 0.8 < K[0, 0] / K[1, 1] < 1.25:
        yield Finding("warning", "calibration", f"{shown}, fy {K[1, 1]:.1f} px: unusual, is it this camera's?")
    else:
        yield Finding("ok", "calibration", shown)
    if frame.baseline_m is not None:
        usual = 0.05 <= frame.baseline_m <= 3
        text = f"baseline {frame.baseline_m:.3f} m, this is the {frame.side} camera"
        yield Finding("ok" if usual else "warning", "calibration", text + ("" if usual else ": unusual, is it metres?"))


def _files(frames: list[Frame]) -> Iterator[Finding]:
    """Can everything be read, and has it the calibration's size?"""
    for what in ("image", "other", "sweep", "truth", "sparse"):
        having = [frame for frame in frames if frame.has(what)]
        if not having:
            yield Finding("note", "files", f"no {what}: {frames[0].missing.get(what, 'the drive has none')}")
            continue
        errors, absent = [], 0
        for frame in having:
            try:
                absent += frame.read(what) is None
            except DataError as error:
                errors.append(str(error))
        read = len(having) - len(errors) - absent
        if errors:
            text = f"{what}: {len(errors)} of {len(having)} sampled cannot be read, the first: {errors[0]}"
            yield Finding("fatal", "files", text)
        elif read:
            yield Finding("ok", "files", f"{what}: {read} of {len(frames)} sampled frames read")
        else:
            yield Finding("warning", "files", f"{what}: none of the {len(having)} sampled frames has one")


def _stereo(frames: list[Frame]) -> Iterator[Finding]:
    """Does the other camera see things shifted to the right side, along rows?"""
    by_frame = [shifts for frame in frames if (shifts := _try(match_corners, frame)) is not None]
    if not by_frame:
        return
    shifts = np.concatenate(by_frame)
    if len(shifts) < 30:
        text = f"only {len(shifts)} corners of {len(by_frame)} frames found in the other image: is it the same moment?"
        yield Finding("warning", "stereo", text)
        return
    disparity_px, rows_px = np.median(shifts, axis=0)
    wrong = float(np.mean(shifts[:, 0] < -0.5))
    text = f"median disparity {disparity_px:.1f} px, vertical offset {rows_px:+.2f} px ({len(shifts)} corners)"
    if wrong > 0.5:
        text += f": {wrong:.0%} are shifted the wrong way: swap left and right images"
        yield Finding("fatal", "stereo", text)
    elif abs(rows_px) > BAD_ROW_PX:
        yield Finding("warning", "stereo", f"{text}: the rows do not match, stereo will be poor: rectify the pair anew")
    elif abs(rows_px) > OFF_ROW_PX or wrong > 0.2:
        yield Finding("warning", "stereo", f"{text}, {wrong:.0%} shifted the wrong way: rectified well?")
    else:
        yield Finding("ok", "stereo", text)


def _poses(frames: list[Frame]) -> Iterator[Finding]:
    """Do the poses move like a car?"""
    posed = [frame for frame in frames if frame.T_world_cam is not None]
    spoilt = [frame for frame in frames if frame.T_world_cam is None and "pose" in frame.missing]
    if spoilt:
        first = spoilt[0].missing["pose"]
        yield Finding("fatal", "poses", f"{len(spoilt)} frames have none, the first {spoilt[0].id}: {first}")
    if len(posed) < 2:
        if spoilt:
            return
        yield Finding("note", "poses", "no poses: sweeps cannot be accumulated, radiance fields cannot be fitted")
        return
    if len(posed) + len(spoilt) < len(frames):
        lacking = [frame.id for frame in frames if frame.T_world_cam is None and frame not in spoilt]
        yield Finding("warning", "poses", f"{len(lacking)} frames have none: {_some(lacking)}")
    T = np.stack([frame.T_world_cam for frame in posed if frame.T_world_cam is not None])
    skewed = np.abs(T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 1e-3
    skewed |= np.linalg.det(T[:, :3, :3]) < 0
    if skewed.any():
        ids = [posed[n].id for n in np.flatnonzero(skewed)]
        yield Finding("fatal", "poses", f"{len(ids)} are no rigid motions: {_some(ids)}: their 3x3 part is no rotation")
    yield from _motion(posed, T)


def _motion(posed: list[Frame], T: npt.NDArray[np.float64]) -> Iterator[Finding]:
    """Speed, jumps, stand-still and direction from poses (n, 4, 4)."""
    steps = np.diff(T[:, :3, 3], axis=0)
    lengths_m = np.linalg.norm(steps, axis=1)
    gaps_s = _gaps_s(posed)
    speed = lengths_m / gaps_s
    around = np.array([np.median(speed[max(0, n - 5) : n + 6]) for n in range(len(speed))])
    jumps = (speed > JUMP * around) & (lengths_m - around * gaps_s > JUMP_M) | (speed > FASTEST_M_S)
    text = f"{len(posed)} poses, {lengths_m.sum():.1f} m, median {np.median(speed):.1f} m/s"
    if jumps.any():
        worst = int(np.argmax(np.where(jumps, lengths_m, 0)))
        where = f"{posed[worst].id} to {posed[worst + 1].id} moves {lengths_m[worst]:.1f} m"
        yield Finding("warning", "poses", f"{text}; {np.count_nonzero(jumps)} jumps, the largest: {where}")
    else:
        yield Finding("ok", "poses", text)
    still = lengths_m < STILL_M
    if still.any():
        many = f"{np.count_nonzero(still)} of {len(still)} steps"
        yield Finding("note", "poses", f"the vehicle stands still in {many}: leave them out with --min-motion 0.1")
    forward = np.einsum("ni,ni->n", T[:-1, :3, 2], steps)[~still] / np.maximum(lengths_m[~still], 1e-9)
    if len(forward) and float(np.median(forward)) < -0.7:
        text = "the camera moves backwards: are they camera-to-world, or is it a rear camera?"
        yield Finding("warning", "poses", text)


def _gaps_s(frames: list[Frame]) -> npt.NDArray[np.float64]:
    """Seconds between frames: by their times, else by their numbers at 10 Hz."""
    times = [frame.time_s for frame in frames]
    if all(time is not None for time in times):
        gaps = np.diff(np.array(times, dtype=np.float64))
    elif all(frame.id.isdecimal() for frame in frames):
        gaps = 0.1 * np.diff(np.array([int(frame.id) for frame in frames], dtype=np.float64))
    else:
        gaps = np.full(len(frames) - 1, 0.1)
    return np.where(gaps > 0, gaps, 0.1)


def _times(frames: list[Frame]) -> Iterator[Finding]:
    """Do the times rise evenly, allowing for frames that were left out?"""
    stamped = [(int(f.id) if f.id.isdecimal() else None, f.time_s) for f in frames if f.time_s is not None]
    if len(stamped) < 2:
        yield Finding("note", "times", "no timestamps: 10 Hz is assumed")
        return
    gaps_s = np.diff(np.array([time for _, time in stamped]))
    numbers = [number for number, _ in stamped]
    if all(number is not None and number < 10**9 for number in numbers):
        gaps_s = gaps_s / np.diff(np.array(numbers))
    usual = float(np.median(gaps_s))
    if (gaps_s <= 0).any():
        first = [frame.id for frame in frames if frame.time_s is not None][int(np.argmax(gaps_s <= 0)) + 1]
        yield Finding("fatal", "times", f"times do not rise at frame {first}: are the timestamps of another drive?")
        return
    long = np.count_nonzero(gaps_s > 1.5 * usual)
    text = f"{1 / usual:.1f} Hz" + (f", {long} pauses, up to {gaps_s.max():.2f} s" if long else "")
    yield Finding("warning" if long else "ok", "times", text)


def _lidar(frames: list[Frame]) -> Iterator[Finding]:
    """Does the sweep, projected, agree with what stereo sees?"""
    having = [frame for frame in frames if frame.has("sweep") and frame.T_cam_lidar is not None]
    if not having:
        return
    if not any(frame.has("other") and frame.baseline_m for frame in having):
        yield Finding("note", "lidar", "agreement with the camera not checked: it needs the second camera")
        return
    by_frame = [pairs for frame in having if (pairs := _try(compare_sweep, frame)) is not None]
    pairs = np.concatenate(by_frame) if by_frame else np.zeros((0, 2))
    if len(pairs) < 200:
        text = f"only {len(pairs)} points fall where stereo sees something: does calibration place it on this camera?"
        yield Finding("fatal", "lidar", text)
        return
    off_px = float(np.median(np.abs(pairs[:, 0] - pairs[:, 1])))
    off = float(np.median(np.abs(pairs[:, 1] / pairs[:, 0] - 1)))
    text = f"median deviation from stereo {off:.1%} of the depth, {off_px:.2f} px of disparity ({len(pairs)} points)"
    if off > LIDAR_BAD:
        yield Finding("fatal", "lidar", f"{text}: calibration or joins are wrong")
    elif off_px > LIDAR_PX or off > LIDAR_OFF:
        yield Finding("warning", "lidar", f"{text}: calibration, times or baseline are doubtful")
    else:
        yield Finding("ok", "lidar", text)


def _try(read: Callable[[Frame], npt.NDArray[np.float64] | None], frame: Frame) -> npt.NDArray[np.float64] | None:
    """Run a comparison; what cannot be read has its own finding."""
    try:
        return read(frame)
    except DataError:
        return None


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
