"""What no training view shows: python tests/bench/bench_unseen.py RUN

A run's held-out views, each parted by the drive's dense truth: pixels whose surface no training view shows (covered,
out of the image, or moved), and all others. A row a view: share of such pixels, their share of the squared error, PSNR
of either part, and the view's PSNR if all other pixels were exact, or as the nearest training view that sees each shows
them by the truth. Pixels without a truth (sky) count as seen, and as right in the last two columns.
"""

import argparse
import math
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from nerf.run import open_run
from nerf.scene import Scene
from nerf.warp.frames import unlike_m
from priors.geometry import invert, project, rays, transform
from priors.types import Drive

Floats = npt.NDArray[np.float32]
SAME = 0.03
"""A training view sees a place where its true depth there differs by this share at most."""


class Shown(NamedTuple):
    """What the training views show of a held-out one by the truth, (h, w, ...)."""

    known: npt.NDArray[np.bool_]
    """Pixels with a truth."""
    seen: npt.NDArray[np.bool_]
    """Pixels that a training view sees, or that have no truth."""
    rgb: Floats
    """Colours in the nearest view that sees each; 0 where none does."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    run = open_run(parser.parse_args().run)
    scene, model = run.scene, run.open_model()
    print("| view | unseen | their share of the error | PSNR there | elsewhere | all else exact | by the truth |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    rows = []
    for position in scene.test:
        truth = np.asarray(scene.images[position], np.float32) / 255
        drawn = np.clip(model.render(scene.T_world_cam[position], scene.camera).rgb, 0, 1)
        shown = shown_of(scene, run.drive, position)
        error, warped = (((rgb - truth) ** 2).mean(-1) for rgb in (drawn, shown.rgb))
        unseen = np.where(shown.seen, 0, error)
        best = unseen + np.where(shown.seen & shown.known, warped, 0)
        parts = (error[~shown.seen], error[shown.seen], unseen, best)
        rows.append(((~shown.seen).mean(), unseen.sum() / error.sum(), *map(_psnr, parts)))
        print(_line(scene.ids[position], rows[-1]))
    print(_line("mean", tuple(np.mean(rows, axis=0))))


def shown_of(scene: Scene, drive: Drive, position: int) -> Shown:
    """Return what the training views show of a held-out view, the nearest that sees a place first."""
    truth_m = drive[drive.ids.index(scene.ids[position])].truth().depth_m
    known = truth_m > 0
    places_m = transform(scene.T_world_cam[position], (rays(scene.camera) * truth_m[..., None]).reshape(-1, 3))
    seen, rgb = ~known, np.zeros((*known.shape, 3), np.float32)
    train = np.array(scene.train)
    away_m = unlike_m(scene.T_world_cam[train], scene.T_world_cam[position])
    for other in train[np.argsort(away_m, kind="stable")]:
        uv, z = project(scene.camera, transform(invert(scene.T_world_cam[other]), places_m))
        u, v = (np.where(z > 0, part, -10).reshape(known.shape).astype(np.float32) for part in uv.T)
        there_m = drive[drive.ids.index(scene.ids[other])].truth().depth_m
        depth_m = cv2.remap(there_m, u, v, cv2.INTER_NEAREST, borderValue=0)
        z = z.reshape(known.shape)
        sees = ~seen & (np.abs(depth_m - z) < SAME * z)
        image = np.asarray(scene.images[other], np.float32) / 255
        rgb[sees] = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[sees]
        seen |= sees
    return Shown(known, seen, rgb)


def _psnr(error: npt.NDArray[np.floating]) -> float:
    return -10 * math.log10(max(float(error.mean()), 1e-10)) if error.size else math.nan


def _line(name: str, row: tuple[float, ...]) -> str:
    unseen, share, *psnr = row
    return f"| {name} | {unseen:.1%} | {share:.0%} | " + " | ".join(f"{value:.2f}" for value in psnr) + " |"


if __name__ == "__main__":
    main()
