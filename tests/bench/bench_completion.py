"""What completion costs and gains over the morphological recipe: python tests/bench/bench_completion.py [DRIVE].

Frames with sparse maps and truth, by default 5-16 of drive 0001. First the methods' times, interleaved, with images
and maps in memory; then every depth metric (protocol uncapped); then error against the number of scan lines kept.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from eval.protocol import preset
from eval.result import Result, score
from eval.table import show
from priors.bench.baselines import fill
from priors.draw.lines import Line, Plot, write
from priors.drives import open_drive
from priors.errors import DataError
from priors.geometry import invert, rays, transform
from priors.methods.completion import Completion, complete
from priors.types import Depth, Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
Fill = Callable[[Frame, np.ndarray, np.ndarray], Depth]


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


def clock(make: Callable[..., Depth], *given: Any) -> float:
    """Return how many milliseconds one call takes."""
    start = time.perf_counter()
    make(*given)
    return 1e3 * (time.perf_counter() - start)


def fills(weights: Path | None) -> dict[str, Fill]:
    """Return the methods compared; the network only where its weights are."""
    found: dict[str, Fill] = {"recipe": lambda frame, image, sparse_m: Depth(fill(sparse_m))}
    found["completion"] = lambda frame, image, sparse_m: complete(sparse_m, image, frame.camera, frame.T_cam_lidar)
    network = Completion(model="mffnet", weights=weights)
    try:
        network.weights_digest()
    except DataError as error:
        print(f"without the network: {error}")
    else:
        found["mffnet"] = lambda frame, image, sparse_m: network.fill(sparse_m, image, frame.camera, frame.T_cam_lidar)
    return found


def time_all(held: list, methods: dict[str, Fill], rounds: int) -> None:
    spent = []
    for _ in range(rounds + 1):
        for frame, image, sparse_m, _ in held:
            spent.append([clock(make, frame, image, sparse_m) for make in methods.values()])
    table = np.array(spent[len(held) :])  # the first round warms up
    for name, ms in zip(methods, table.T, strict=True):
        ratio = np.median(ms / table[:, 0])
        print(f"{name}: median {np.median(ms):.1f} ms, fastest {ms.min():.1f} ms, {ratio:.2f} x the recipe (pairs)")


def score_all(held: list, methods: dict[str, Fill], every: int = 1) -> list[Result]:
    results = []
    for name, make in methods.items():
        scored = []
        for frame, image, sparse_m, truth_m in held:
            samples = sparse_m if every == 1 else keep_lines(frame, sparse_m, every)
            depth = make(frame, image, samples)
            scored.append((frame.id, depth.depth_m, depth.confidence, truth_m))
        results.append(score(scored, preset("uncapped"), info={"prior": name}))
    return results


def draw(lines: list[int], errors: dict[str, list[float]]) -> Plot:
    """Plot error over the number of lines."""
    curves = [Line(name, np.array(lines), np.array(values)) for name, values in errors.items()]
    return Plot(curves, "scan lines", "AbsRel, %", "completion of fewer scan lines", x_scale="log")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", nargs="?", type=Path, default=DRIVE)
    parser.add_argument("--weights", type=Path, help="of the network, instead of those that ship")
    parser.add_argument("--plot", type=Path, help=".png, .svg or .pdf to write error against scan lines to")
    parser.add_argument("--rounds", type=int, default=6, help="of timing; 0: none")
    given = parser.parse_args()
    drive = open_drive(given.drive)
    frames = [frame for frame in (drive[i] for i in range(len(drive))) if frame.has("sparse") and frame.has("truth")]
    held = [(f, f.image(), f.sparse().depth_m, f.truth().depth_m) for f in frames]
    print(f"{drive.name}: {len(held)} frames, {held[0][0].camera.size[1]}x{held[0][0].camera.size[0]}")
    methods = fills(given.weights)
    if given.rounds:
        time_all(held, methods, given.rounds)
    show(score_all(held, methods))
    errors: dict[str, list[float]] = {name: [] for name in methods}
    lines = [64, 32, 16, 8]
    for kept in lines:
        cells = []
        for result in score_all(held, methods, 64 // kept):
            figures, name = result.metrics(), result.info["prior"]
            errors[name].append(100 * figures["abs_rel"])
            cells.append(f"{name} {figures['abs_rel']:.4f} {figures['rmse']:.3f} m {figures['mae']:.3f} m")
        print(f"{kept:3d} lines, AbsRel RMSE MAE: {', '.join(cells)}")
    if given.plot:
        write(given.plot, [draw(lines, errors)])


if __name__ == "__main__":
    main()
