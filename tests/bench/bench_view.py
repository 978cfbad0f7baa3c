"""How fast a field's view follows: pictures a second while a camera moves, seconds until it is whole once it stands.

    python tests/bench/bench_view.py [RUN ...] [--browsers 2] [--size 397x120]

A camera glides along the run's path at 30 messages a second, as a browser sends them; then it stands. What a browser
is sent is encoded as in the view (JPEG, and the depth as PNG), but nothing is drawn: no browser takes the cores.
"""

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from nerf.config import FitConfig, ModelConfig
from nerf.prepare import SceneConfig
from nerf.run import Run, begin, open_run
from nerf.video import interpolate
from nerf.view import lens
from nerf.view.painter import Painter
from nerf.view.picture import Picture
from priors import build
from priors.drives import open_drive
from priors.geometry import resize
from priors.machine import cpu, threads
from priors.methods.lidar import Lidar
from priors.street.write import write_street
from priors.types import Camera, Matrix

MOVING_S, MESSAGES_A_SECOND = 6.0, 30
FAMILIES, STEPS = ("ngp", "mip360", "nerfpp"), 300


class Audience:
    """Browsers that are only counted."""

    def __init__(self) -> None:
        self.pictures: dict[int, list[float]] = {}
        self.whole_s: dict[int, float] = {}
        self.changed = threading.Condition()

    def deliver(self, client: int, picture: Picture) -> None:
        """Encode a picture as a browser gets it, and note when."""
        from viser._image_encoding import cv2_imencode_with_fallback as encode

        view = picture.view()
        encode("jpeg", lens.colours(view, depth=False), 90, "rgb")
        fixed = np.clip(lens.hiding_m(view) * 100_000, 0, 2**24 - 1).astype(np.uint32)
        encode("png", fixed[..., None].view(np.uint8), None, "bgr")
        with self.changed:
            self.pictures.setdefault(client, []).append(time.perf_counter())
            if picture.whole:
                self.whole_s[client] = time.perf_counter()
            self.changed.notify_all()


def measure(painter: Painter, audience: Audience, path: list[Matrix], camera: Camera, browsers: int) -> None:
    """Move, stand, and print one line a browser."""
    began = time.perf_counter()
    for number in range(round(MOVING_S * MESSAGES_A_SECOND)):
        time.sleep(max(0.0, began + number / MESSAGES_A_SECOND - time.perf_counter()))
        for client in range(browsers):
            painter.ask(client, path[number % len(path)], camera)
    stood = time.perf_counter()
    with audience.changed:
        audience.whole_s.clear()
        audience.changed.wait_for(lambda: len(audience.whole_s) == browsers, 120)
    for client in range(browsers):
        moving = [when for when in audience.pictures[client] if began <= when < stood]
        gaps = np.diff([began, *moving])
        rate, whole_s = len(moving) / (stood - began), audience.whole_s[client] - stood
        print(
            f"browser {client + 1} of {browsers}: {rate:.1f} pictures/s while moving (longest gap {gaps.max():.2f} s), "
            f"whole after {whole_s:.2f} s"
        )


def measure_run(run: Run, size: str, most: int) -> None:
    """Measure a run for one browser, then more at once."""
    views, model = run.viewpoints(), run.open_model()
    camera = views.camera
    if size:
        width, height = map(int, size.split("x"))
        camera = resize(camera, (height, width))
    path = list(interpolate(views.T_world_cam, 8))
    shape = f"{camera.size[1]}x{camera.size[0]}"
    print(f"{run.name}: {run.config.fit.model.family}, {shape}, {threads.count()} threads, {cpu.mode()}")
    for browsers in range(1, most + 1):
        audience = Audience()
        painter = Painter(model.render, audience.deliver)
        painter.warm(path[0], resize(camera, (40, 120)))
        painter.start()
        measure(painter, audience, path, camera, browsers)
        painter.stop()


def street_runs(folder: Path) -> list[Run]:
    """Fit each family to a street for a little while: 397x120, with its LiDAR."""
    write_street(folder / "street", 12, 7, (120, 397))
    drive = open_drive(folder / "street")
    prior = build.prepare(drive, Lidar(), folder=folder / "cache").run().prior
    runs = []
    for family in FAMILIES:
        fit = FitConfig(ModelConfig(family=family), steps=STEPS)
        runs.append(begin(drive, prior, SceneConfig(views="sparse"), fit, folder / "runs" / family))
        runs[-1].fit()
    return runs


def main() -> None:
    """Measure the runs that are named, or a small one of each family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="*", help="runs' folders; default: one of each family, made here")
    parser.add_argument("--browsers", type=int, default=2, help="measured from one up to so many at once")
    parser.add_argument("--size", default="", help="of the picture, WIDTHxHEIGHT; default: the drive's")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threads.limited(threads.usual()):
        for run in map(open_run, args.runs) if args.runs else street_runs(Path(folder)):
            measure_run(run, args.size, args.browsers)


if __name__ == "__main__":
    main()
