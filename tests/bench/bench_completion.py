"""What completion costs and gains over the morphological recipe: python tests/bench/bench_completion.py [DRIVE].

Frames with sparse maps and truth, by default 5-16 of drive 0001. First both methods' times, interleaved, with images
and maps in memory; then every depth metric (protocol uncapped); then error against the number of scan lines kept.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eval.protocol import preset
from eval.result import Result, score
from eval.table import show
from priors.drives import open_drive
from priors.geometry import invert, rays, transform
from priors.methods.completion import complete
from priors.types import Depth, Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
DIAMOND = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
FAR_M = 100.0


def recipe(sparse_m: np.ndarray) -> Depth:
    """Fill a sparse map by morphology alone, near surfaces first (Ku, Harakeh, Waslander 2018: IP-Basic)."""
    closeness = np.where(sparse_m > 0.1, FAR_M - sparse_m, 0).astype(np.float32)
    closeness = cv2.dilate(closeness, cv2.dilate(np.pad(DIAMOND, 1), DIAMOND))  # a 5x5 diamond
    closeness = cv2.morphologyEx(closeness, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    closeness = np.where(closeness > 0.1, closeness, cv2.dilate(closeness, np.ones((7, 7), np.uint8)))
    first = np.argmax(closeness > 0.1, axis=0)
    top = closeness[first, np.arange(closeness.shape[1])]
    closeness = np.where(np.arange(closeness.shape[0])[:, None] < first, top, closeness)
    closeness = np.where(closeness > 0.1, closeness, cv2.dilate(closeness, np.ones((31, 31), np.uint8)))
    closeness = cv2.medianBlur(closeness, 5)
    closeness = np.where(closeness > 0.1, cv2.GaussianBlur(closeness, (5, 5), 0), closeness)
    return Depth(np.where(closeness > 0.1, FAR_M - closeness, 0).astype(np.float32))


def keep_lines(frame: Frame, sparse_m: np.ndarray, every: int) -> np.ndarray:
    """Keep every n-th of an HDL-64's lines (1/3 degree apart from +2 down to -8.33, then 1/2)."""
    assert frame.T_cam_lidar is not None
    row, column = np.nonzero(sparse_m)
    xyz = transform(invert(frame.T_cam_lidar), rays(frame.camera)[row, column] * sparse_m[row, column, None])
    angle = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    line = np.rint(np.where(angle > -8.58, (2 - angle) * 3, 32 + (-8.83 - angle) * 2)).astype(int)
    kept = np.zeros_like(sparse_m)
    chosen = line % every == 0
    kept[row[chosen], column[chosen]] = sparse_m[row[chosen], column[chosen]]
    return kept


def clock(fill: Callable[..., Depth], *given: Any) -> float:
    """Return how many milliseconds one call takes."""
    start = time.perf_counter()
    fill(*given)
    return 1e3 * (time.perf_counter() - start)


def time_both(held: list, rounds: int = 6) -> None:
    spent = []
    for _ in range(rounds + 1):
        for frame, image, sparse_m, _ in held:
            spent.append((clock(recipe, sparse_m), clock(complete, sparse_m, image, frame.camera, frame.T_cam_lidar)))
    a, b = np.array(spent[len(held) :]).T  # the first round warms up
    print(
        f"recipe {np.median(a):.1f} ms, completion {np.median(b):.1f} ms, ratio {np.median(b / a):.2f} (pairs' median)"
    )


def score_both(held: list, every: int = 1) -> list[Result]:
    results = []
    for name in ("recipe", "completion"):
        scored = []
        for frame, image, sparse_m, truth_m in held:
            samples = sparse_m if every == 1 else keep_lines(frame, sparse_m, every)
            depth = recipe(samples)
            if name == "completion":
                depth = complete(samples, image, frame.camera, frame.T_cam_lidar)
            scored.append((frame.id, depth.depth_m, depth.confidence, truth_m))
        results.append(score(scored, preset("uncapped"), info={"prior": name}))
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", nargs="?", type=Path, default=DRIVE)
    drive = open_drive(parser.parse_args().drive)
    frames = [frame for frame in (drive[i] for i in range(len(drive))) if frame.has("sparse") and frame.has("truth")]
    held = [(f, f.image(), f.sparse().depth_m, f.truth().depth_m) for f in frames]
    print(f"{drive.name}: {len(held)} frames, {held[0][0].camera.size[1]}x{held[0][0].camera.size[0]}")
    time_both(held)
    show(score_both(held))
    for every in (1, 2, 4, 8):
        cells = []
        for result in score_both(held, every):
            figures = result.metrics()
            cells.append(f"{result.info['prior']} AbsRel {figures['abs_rel']:.4f} RMSE {figures['rmse']:.3f} m")
        print(f"{64 // every:3d} lines: {', '.join(cells)}")


if __name__ == "__main__":
    main()
