"""What KITTI's pairs are off by, measured in three ways that share no sensor: sweeps, a teacher's maps, ego-motion.

    python tests/bench/bench_rig.py                                     # needs ../shared/data
    python tests/bench/bench_rig.py --teacher maps/                     # and disparities of kitti_odometry pairs, .npy

Each line is scale * d + shift + tilt X + yaw X^2 + pitch X Y (priors/pairs/rectification.py), fitted to all frames, and
how far it moves if frames are drawn anew. Ego-motion: corners are tracked into the next image, and the drive's poses
say how far away they are. The teacher's maps are those that `python -m priors.learn.teacher_labels` makes with a
network that is fine-tuned on KITTI's truth.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from priors import drives
from priors.codecs import as_grey
from priors.drives import DriveOptions
from priors.geometry import invert
from priors.learn.teacher_maps import find_map
from priors.pairs.matching import match
from priors.pairs.read import read_pair
from priors.pairs.rectification import RectificationError, Residuals, compare, compare_with_sweep, fit, join, row_slope
from priors.types import Drive, FloatMap, Frame

DATA = Path(__file__).resolve().parents[3] / "shared/data"
STEP, DRAWS = 3, 8
"""Every third frame; draws of frames."""
TRACK = {"winSize": (13, 13), "maxLevel": 0, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW, "criteria": (3, 40, 1e-3)}
FAITHFUL_PX, SIDEWAYS_PX, LEAST_PARALLAX = 0.3, 0.3, 0.12
"""Of a track: how near the way back ends, how far off the epipolar line it is, px of motion per px of disparity."""


def main() -> None:
    """Print a line for each way and drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--teacher", type=Path)
    options = parser.parse_args()
    raw = drives.open_drive(options.data / "kitti_raw/2011_09_26/2011_09_26_drive_0001_sync")
    paired = [index for index in range(len(raw)) if raw[index].has("other")]
    show("drive 0001, sweeps", (by_sweep(raw[index]) for index in paired[::STEP]))
    show("drive 0001, ego-motion", (by_motion(raw, index) for index in paired[:-1]))
    for sequence in ("06", "01"):
        drive = drives.open_drive(options.data / "kitti_odometry", options=DriveOptions(drive=sequence))
        show(f"odometry {sequence}, ego-motion", (by_motion(drive, index) for index in range(0, len(drive) - 1, STEP)))
        frames = (drive[index] for index in range(len(drive)))
        named = ((frame, find_map(options.teacher, f"{sequence}_{frame.id}")) for frame in frames)
        maps = [(frame, path) for frame, path in named if path is not None]
        show(f"odometry {sequence}, teacher", (by_teacher(frame, np.load(path)) for frame, path in maps))


def show(name: str, parts: Iterable[Residuals]) -> None:
    """Print the fit to all frames, and the deviation over draws of the frames."""
    frames = list(parts)
    if not frames:
        return
    rng = np.random.default_rng(0)
    draws = [rng.integers(0, len(frames), len(frames)) for _ in range(DRAWS)]
    spread = np.std([flat(fit(join([frames[i] for i in draw]))) for draw in draws], axis=0)
    whole = flat(fit(join(frames)))
    cells = [f"{value:.3f} +-{more:.3f}" for value, more in zip(whole, spread, strict=True)]
    print(f"{name:24} shift tilt yaw pitch px, scale: {', '.join(cells)}  ({len(frames)} frames)", flush=True)


def flat(error: RectificationError) -> list[float]:
    """Return the five numbers."""
    return [*error.offset_px, error.scale]


def by_sweep(frame: Frame) -> Residuals:
    """Gather what a frame's sweep says of the match."""
    pair, sweep = read_pair(frame), frame.sweep()
    assert frame.T_cam_lidar is not None and frame.baseline_m is not None and sweep is not None
    matched_px = match(pair.left, pair.right)
    return compare_with_sweep(matched_px, pair.left, frame.camera, frame.baseline_m, sweep, frame.T_cam_lidar)


def by_teacher(frame: Frame, teacher_px: FloatMap) -> Residuals:
    """Gather what a teacher's map says of it: every 20th pixel, neighbours tell the same."""
    matched_px = read_pair(frame).match(match)
    slope_px = row_slope(blurred(matched_px))
    residuals = compare(frame.camera, teacher_px.astype(np.float32), matched_px, slope_px)
    return Residuals(residuals.factors[::20], residuals.residual_px[::20])


def by_motion(drive: Drive, index: int) -> Residuals:
    """Gather what the motion to the next frame says of it."""
    frame = drive[index]
    pair = read_pair(frame)
    matched_px = match(pair.left, pair.right)
    true_px = motion_disparity(frame, as_grey(pair.left), drive[index + 1], matched_px)
    return compare(frame.camera, true_px, matched_px, row_slope(blurred(matched_px)))


def blurred(matched_px: FloatMap) -> FloatMap:
    """Return a match that is smooth enough to have a slope."""
    return np.asarray(cv2.GaussianBlur(matched_px, (0, 0), 2), np.float32)


def motion_disparity(frame: Frame, grey: Any, after: Frame, matched_px: FloatMap) -> FloatMap:
    """Return the disparity (height, width) px at tracked corners, 0 elsewhere, that the two poses give."""
    K, fx_baseline = frame.camera.K, frame.camera.fx * (frame.baseline_m or 0)
    assert frame.T_world_cam is not None and after.T_world_cam is not None
    T = invert(after.T_world_cam) @ frame.T_world_cam
    start = cv2.goodFeaturesToTrack(grey, 3000, 0.003, 5)[:, 0]
    column, row = start.astype(int).T
    start, near_px = start[matched_px[row, column] > 0], matched_px[row, column][matched_px[row, column] > 0]
    rays = np.linalg.solve(K, np.concatenate([start, np.ones((len(start), 1))], axis=1).T)

    def land(disparity_px: Any) -> Any:
        seen = K @ (T[:3, :3] @ rays + disparity_px / fx_baseline * T[:3, 3:])
        return (seen[:2] / seen[2]).T

    expected = land(near_px)
    later, guess = as_grey(after.image()), np.ascontiguousarray(expected, np.float32)
    ahead, there, _ = cv2.calcOpticalFlowPyrLK(grey, later, start, guess, None, **TRACK)
    back, again, _ = cv2.calcOpticalFlowPyrLK(later, grey, ahead, start.copy(), None, **TRACK)
    parallax = (land(near_px + 0.01) - expected) / 0.01  # px of motion per px of disparity
    size = np.linalg.norm(parallax, axis=1)
    moved = ahead - expected
    along = (moved * parallax).sum(1) / size**2
    sideways = np.abs(moved[:, 0] * parallax[:, 1] - moved[:, 1] * parallax[:, 0]) / size
    good = (there[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm(back - start, axis=1) < FAITHFUL_PX)
    good &= (sideways < SIDEWAYS_PX) & (size > LEAST_PARALLAX)
    true_px = np.zeros_like(matched_px)
    column, row = start[good].astype(int).T
    true_px[row, column] = np.maximum(near_px + along, 0)[good]
    return true_px


if __name__ == "__main__":
    main()
