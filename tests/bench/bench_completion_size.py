"""Completion's network at enlarged images: what mffnet would gain where images are small. A prototype; no flag does it.

python tests/bench/bench_completion_size.py half/2011_09_26/2011_09_26_drive_0009_sync --frames 26 32 38 44 50

Shown is each frame's own sweep without every fourth scan line. Truth: the drive's, else the lines that are not shown.
Image and samples are enlarged, the map is brought back. One thread. Half size: tests/bench/resize.py.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from priors import geometry
from priors.drives import open_drive
from priors.learn.accumulated_lidar import own_scene
from priors.learn.lidar_dropout import own_m
from priors.learn.lidar_scene import splat
from priors.machine import threads
from priors.methods._stereo_size import bring_image, bring_map, bring_mask
from priors.methods.completion import Completion
from priors.types import FloatMap, Frame

FARTHEST_M, EVERY = 90.0, 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", help="positions in the drive; default: all")
    parser.add_argument("--factors", type=float, nargs="+", default=[1.0, 1.6, 2.0])
    options = parser.parse_args()
    drive = open_drive(options.drive)
    frames = [drive[at] for at in options.frames or range(len(drive))]
    shown = [split(frame) for frame in frames]
    print(f"{len(frames)} frames of {drive.name}, {frames[0].camera.size[1]} px wide")
    print(f"{'':14}{'AbsRel':>8}{'RMSE m':>8}{'CPU ms':>8}")
    with threads.limited(1):
        for model, factor in [("classical", 1.0), *(("mffnet", factor) for factor in options.factors)]:
            method = Completion(model=model, source="lidar").resolve(frames[0])
            fill(method, frames[0], shown[0][0], factor)  # what is compiled at the first call
            start = time.process_time()
            maps = [fill(method, frame, sparse_m, factor) for frame, (sparse_m, _) in zip(frames, shown, strict=True)]
            spent_ms = 1e3 * (time.process_time() - start) / len(frames)
            rel, rmse = np.mean([score(ours, truth) for ours, (_, truth) in zip(maps, shown, strict=True)], axis=0)
            print(f"{model:9} x{factor:<4g}{rel:8.4f}{rmse:8.3f}{spent_ms:8.0f}", flush=True)


def split(frame: Frame) -> tuple[FloatMap, FloatMap]:
    """Return what is shown of a frame's sweep, and the truth beside it, metres, 0 = none."""
    scene = own_scene(frame, np.zeros(frame.camera.size, np.float32), "")
    kept = scene.beam % EVERY != 1
    sparse_m = splat(scene.points_m[kept], scene.camera)
    truth_m = frame.truth().depth_m if frame.has("truth") else own_m(scene)
    return sparse_m, np.where((sparse_m > 0) | (truth_m > FARTHEST_M), np.float32(0), truth_m)


def fill(method: Completion, frame: Frame, sparse_m: FloatMap, factor: float) -> FloatMap:
    """Fill a map seen so many times larger."""
    image, size = frame.image(), sparse_m.shape
    if factor == 1:
        return method.fill(sparse_m, image, frame.camera, frame.T_cam_lidar).depth_m
    large = round(size[0] * factor), round(size[1] * factor)
    camera = geometry.resize(frame.camera, large)
    row, column = np.nonzero(sparse_m)
    placed_m = np.zeros(large, np.float32)
    placed_m[place(row, size[0], large[0]), place(column, size[1], large[1])] = sparse_m[row, column]
    wide = replace(method, reach_px=round(method.reach_px * factor))
    depth_m = wide.fill(placed_m, bring_image(image, large), camera, frame.T_cam_lidar).depth_m
    inverse = bring_map(np.where(depth_m > 0, 1 / np.maximum(depth_m, np.float32(1e-3)), np.float32(0)), size)
    known = bring_mask(depth_m > 0, size) & (inverse > 0)
    return np.divide(np.float32(1), inverse, out=np.zeros_like(inverse), where=known)


def place(number: np.ndarray, count: int, large: int) -> np.ndarray:
    """Return the rows, or columns, in the enlarged image whose middle is nearest."""
    return np.clip(np.rint((number + 0.5) * large / count - 0.5).astype(np.intp), 0, large - 1)


def score(depth_m: FloatMap, truth_m: FloatMap) -> tuple[float, float]:
    """Return AbsRel and RMSE, metres."""
    known = (depth_m > 0) & (truth_m > 0)
    ours_m, true_m = depth_m[known], truth_m[known]
    return float(np.mean(np.abs(ours_m / true_m - 1))), float(np.sqrt(np.mean((ours_m - true_m) ** 2)))


if __name__ == "__main__":
    main()
