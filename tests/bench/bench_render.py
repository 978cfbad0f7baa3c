"""How fast a trained field renders: views a second, and milliseconds of processor time a view.

    python tests/bench/bench_render.py RUN [RUN ...] [--size 397x120] [--rounds 3] [--threads 2]

Each run renders poses between those of its drive, as a video does: colour, depth and opacity. The median of all views
is told. Runs take turns, so that a machine that slows down slows all of them.
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from nerf.run import Run, open_run
from nerf.video import interpolate
from priors.machine import cpu, threads
from priors.resized import resize

VIEWS = 16


class Rendered:
    """A run that is opened, and what its views took."""

    def __init__(self, run: Run, size: str) -> None:
        views = run.viewpoints()
        self.run, self.model, self.camera = run, run.open_model(), views.camera
        if size:
            width, height = map(int, size.split("x"))
            self.camera = resize(self.camera, (height, width))
        path = list(interpolate(views.T_world_cam, 8))
        self.poses = [path[i] for i in np.linspace(0, len(path) - 1, VIEWS).round().astype(int)]
        self.wall_s: list[float] = []
        self.processor_s: list[float] = []

    def warm(self) -> None:
        """Compile, and fill what is kept between views."""
        self.model.render(self.poses[0], self.camera)

    def round(self) -> None:
        """Render every pose once."""
        for pose in self.poses:
            wall, processor = time.perf_counter(), time.process_time()
            self.model.render(pose, self.camera)
            self.wall_s.append(time.perf_counter() - wall)
            self.processor_s.append(time.process_time() - processor)

    def line(self) -> str:
        """Say what a view takes."""
        wall, processor = statistics.median(self.wall_s), statistics.median(self.processor_s)
        shape = f"{self.camera.size[1]}x{self.camera.size[0]}"
        took = f"{1 / wall:.1f} views/s, {processor * 1e3:.1f} ms of processor time a view"
        return f"{self.run.name}: {self.run.config.fit.model.family}, {shape}: {took}"


def main() -> None:
    """Measure the runs that are named, in turns."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="runs' folders")
    parser.add_argument("--size", default="", help="of a view, WIDTHxHEIGHT; default: the drive's")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=threads.usual())
    args = parser.parse_args()
    with threads.limited(args.threads):
        opened = [Rendered(open_run(folder), args.size) for folder in args.runs]
        for one in opened:
            one.warm()
        for _ in range(args.rounds):
            for one in opened:
                one.round()
    print(f"{args.threads} threads, {cpu.mode()}")
    for one in opened:
        print(one.line())


if __name__ == "__main__":
    main()
