"""LiDAR: does the sweep, projected, agree with what stereo sees?"""

from collections.abc import Iterator, Sequence

import numpy as np

from priors.check.finding import Finding
from priors.check.sample import Sample

FEWEST = 200
"""Points that must fall where stereo sees something."""
OFF_PX, OFF, BAD = 2.0, 0.1, 0.2
"""Disparity, and share of the depth, that are doubtful; share that is fatal."""


def judge_lidar(sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Compare the sampled frames' sweeps with stereo."""
    having = [sample for sample in sampled if sample.frame.has("sweep") and sample.frame.T_cam_lidar is not None]
    if not having:
        return
    if not any(sample.frame.has("other") and sample.frame.baseline_m for sample in having):
        yield Finding("note", "lidar", "agreement with the camera not checked: it needs the second camera")
        return
    by_frame = [pairs for sample in having if (pairs := sample.sweep_pairs) is not None]
    pairs = np.concatenate(by_frame) if by_frame else np.zeros((0, 2))
    if len(pairs) < FEWEST:
        text = f"only {len(pairs)} points fall where stereo sees something: does calibration place it on this camera?"
        yield Finding("fatal", "lidar", text)
        return
    off_px = float(np.median(np.abs(pairs[:, 0] - pairs[:, 1])))
    off = float(np.median(np.abs(pairs[:, 1] / pairs[:, 0] - 1)))
    text = f"median deviation from stereo {off:.1%} of the depth, {off_px:.2f} px of disparity ({len(pairs)} points)"
    if off > BAD:
        yield Finding("fatal", "lidar", f"{text}: calibration or joins are wrong")
    elif off_px > OFF_PX or off > OFF:
        yield Finding("warning", "lidar", f"{text}: calibration, times or baseline are doubtful")
    else:
        yield Finding("ok", "lidar", text)
