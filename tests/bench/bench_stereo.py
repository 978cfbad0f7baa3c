"""Stereo against OpenCV's matcher: time in one interleaved run, accuracy, and both sparsification curves.

python tests/bench/bench_stereo.py [--data DRIVE] [--truth DIR]
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.drives import DriveOptions, open_drive
from priors.geometry import convert_disparity
from priors.methods.stereo import Stereo
from priors.types import Depth, Frame

SHARES = (1.0, 0.9228, 0.8, 0.6, 0.4, 0.2)
Row = npt.NDArray[np.float64]

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"


def three_way(frame: Frame) -> Depth:
    """OpenCV's 3-way matcher at 192 disparities, grey, left view."""
    matcher = cv2.StereoSGBM.create(0, 192, 3, 72, 288, 1, 63, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    disparity_px = matcher.compute(as_grey(frame.image()), as_grey(frame.other())).astype(np.float32) / 16
    assert frame.baseline_m is not None
    return Depth(convert_disparity(disparity_px, frame.camera.fx, frame.baseline_m))


def in_memory(frame: Frame) -> Frame:
    """The frame with its images read, so that only the method is timed."""
    image, other = frame.image(), frame.other()
    return replace(frame, readers={**frame.readers, "image": lambda: image, "other": lambda: other})


def milliseconds(run: Callable[[Frame], Depth], frame: Frame) -> float:
    start = time.perf_counter()
    run(frame)
    return 1e3 * (time.perf_counter() - start)


def errors(depth: Depth, truth: Depth) -> tuple[Row, Row, npt.NDArray[np.float32]]:
    """Error (m), true depth (m) and confidence at the truth's pixels that have a value; depth clipped to 80 m."""
    both = truth.valid & depth.valid
    confidence = depth.confidence[both] if depth.confidence is not None else np.ones(both.sum(), np.float32)
    found_m = np.clip(depth.depth_m[both], 1e-3, 80).astype(np.float64)
    return found_m - truth.depth_m[both], truth.depth_m[both].astype(np.float64), confidence


def figures(error_m: Row, true_m: Row) -> list[float]:
    """AbsRel, RMSE (m), MAE (m)."""
    return [np.mean(np.abs(error_m) / true_m), np.sqrt(np.mean(error_m**2)), np.mean(np.abs(error_m))]


def main() -> None:
    """Print the ratio of times, and the accuracy where the drive has truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DRIVE)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    drive = open_drive(options.data, options=DriveOptions(truth=options.truth))
    images_only = Stereo(offset_px=(0.0, 0.0, 0.0))
    calibrated = Stereo().resolve(drive[0])
    frames = [in_memory(drive[index]) for index in range(min(12, len(drive)))]
    images_only(frames[0])

    pairs = [
        (milliseconds(three_way, frame), milliseconds(images_only, frame))
        for _ in range(options.rounds)
        for frame in frames
    ]
    theirs, ours = np.median(pairs, axis=0)
    ratio = np.median([b / a for a, b in pairs])
    print(
        f"3-way SGBM, 192 disparities: {theirs:.0f} ms; stereo: {ours:.0f} ms a frame; "
        f"ratio {ratio:.2f} (median of pairs)"
    )

    frames = [frame for frame in frames if frame.has("truth")]
    if not frames:
        return
    print(f"offset measured on frame {drive[0].id}: {calibrated.offset_px} px, scale {calibrated.scale}")
    print(f"{'':24}{'density':>8}{'AbsRel':>8}{'RMSE':>8}{'MAE':>8}")
    for name, run in (
        ("3-way SGBM", three_way),
        ("stereo, images only", images_only),
        ("stereo, LiDAR offset", calibrated),
    ):
        rows, curves = [], []
        for frame in frames:
            depth, truth = run(frame), frame.truth()
            error_m, true_m, confidence = errors(depth, truth)
            rows.append([np.mean(depth.valid[truth.valid]), *figures(error_m, true_m)])
            orders = [np.argsort(-confidence, kind="stable"), np.argsort(true_m + error_m, kind="stable")]
            kept = [[order[: round(share * order.size)] for share in SHARES] for order in orders]
            curves.append([[figures(error_m[k], true_m[k])[:2] for k in by] for by in kept])
        print(f"{name:24}" + "{:8.4f}{:8.4f}{:8.3f}{:8.3f}".format(*np.mean(rows, axis=0)))
        if name != "3-way SGBM":
            for label, curve in zip(("by confidence", "drop the farthest"), np.mean(curves, axis=0), strict=True):
                print(
                    f"  {label:20}"
                    + "".join(f"  {s:.0%} {a:.4f}/{r:.3f}" for s, (a, r) in zip(SHARES, curve, strict=True))
                )


if __name__ == "__main__":
    main()
