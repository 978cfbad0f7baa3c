"""The table of docs/datasets.md: what each data set can be built and scored by. Each cell is a command, run here."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from factories import (
    depth_m,
    scene,
    write_argoverse_stereo,
    write_argoverse_tracking,
    write_folder,
    write_odometry,
    write_raw,
)
from layouts.argoverse2 import write_log
from layouts.colmap import write_colmap
from layouts.kitti_360 import write_360
from layouts.kitti_single import write_object, write_selection
from layouts.kitti_stereo import write_2015
from layouts.nerfstudio import write_nerfstudio
from layouts.nuscenes import SCENES, write_nuscenes

from cli.priors import PROGRAM
from priors import codecs, drives

pytestmark = pytest.mark.datasets
PAGE = Path(__file__).resolve().parents[1] / "docs" / "datasets.md"
METHODS = ("lidar", "completion", "stereo", "mono")
LOG = "f9fa3960-537f-3151-a1a3-37a9c0d6d7d7"


def write_maps(folder: Path, ids: list[str], step: int = 1) -> None:
    """Write the scene's depth, every step-th pixel, as KITTI's depth maps."""
    sparse_m = np.zeros_like(depth_m(scene()[2]))
    sparse_m[::step, ::step] = depth_m(scene()[2])[::step, ::step]
    for id_ in ids:
        codecs.write_depth_png(folder / f"{id_}.png", sparse_m)


def raw(root: Path) -> list[str]:
    drive, ids = write_raw(root / "raw"), [f"{number:010d}" for number in range(6)]
    write_maps(root / "raw" / "depth" / "train" / drive.name / "proj_depth" / "groundtruth" / "image_02", ids)
    return [str(drive)]


def odometry(root: Path) -> list[str]:
    ids = [f"{number:010d}" for number in range(5)]
    truth = root / "depth"
    write_maps(truth / "train" / "2011_09_30_drive_0020_sync" / "proj_depth" / "groundtruth" / "image_02", ids)
    return [str(write_odometry(root / "odometry")), "--truth", str(truth)]


def folder(root: Path) -> list[str]:
    own = write_folder(root / "own")
    write_maps(own / "sparse", ["a", "b", "c"], 4)
    return [str(own)]


def argoverse1(root: Path) -> list[str]:
    write_argoverse_tracking(root / "argoverse-tracking" / "train1" / LOG)
    return [str(write_argoverse_stereo(root, "train", LOG))]


def colmap(root: Path) -> list[str]:
    for view in write_colmap(root).views:
        codecs.write_depth_png(root / "depths_gt" / f"{Path(view.name).stem}.png", view.depth_m)
    return [str(root)]


def images(root: Path) -> list[str]:
    for number in range(2):
        codecs.write_image(root / "photos" / f"{number}.png", scene(seed=number)[0])
    return [str(root / "photos"), "--fx", "200"]


def nerfstudio(root: Path) -> list[str]:
    write_nerfstudio(root)
    return [str(root)]


WRITERS: dict[str, Callable[[Path], list[str]]] = {
    "kitti_raw": raw,
    "kitti_odometry": odometry,
    "kitti_stereo": lambda root: [str(write_2015(root, sweeps=True))],
    "kitti_360": lambda root: [str(write_360(root))],
    "kitti_depth": lambda root: [str(write_selection(root))],
    "kitti_object": lambda root: [str(write_object(root))],
    "argoverse1": argoverse1,
    "argoverse2": lambda root: [str(write_log(root / "log"))],
    "nuscenes": lambda root: [str(write_nuscenes(root)), "--drive", SCENES[0]],
    "nerfstudio": nerfstudio,
    "colmap": colmap,
    "images": images,
    "folder": folder,
}
"""Data set -> writes one, and returns the words that name it in a command."""


def rows() -> dict[str, list[str]]:
    """The table's cells by data set."""
    section = PAGE.read_text().split("## What works on what\n")[1].split("\n## ")[0]
    found = re.findall(r"^\| `(\w+)` \|(.*)\|$", section, re.MULTILINE)
    return {name: [cell.strip() for cell in cells.split("|")] for name, cells in found}


def test_the_table_has_every_data_set() -> None:
    assert sorted(rows()) == sorted(drives.names()) == sorted(WRITERS)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "argoverse1" else []) for name in WRITERS]
)
def test_each_cell_works_and_no_other(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    if name == "argoverse2":
        pytest.importorskip("pyarrow", reason="Argoverse 2 is read by pyarrow: the extra argoverse2")
    methods, truth, *_ = rows()[name]
    named, home = WRITERS[name](tmp_path / "data"), str(tmp_path / "cache")
    code = PROGRAM.run(["check", *named])
    assert code == (1 if name == "argoverse1" else 0), capsys.readouterr().out  # whose images are blank here: told
    working = []
    for method in METHODS:
        flags = ["--stereo.offset-px", "0"] if method == "stereo" else []
        code = PROGRAM.run(["build", *named, "--method", method, "--cache", home, "--shard", "1/100", *flags])
        printed = capsys.readouterr()
        if code == 0:
            working.append(method)
        else:
            assert "error: no frame can be computed: " in printed.err, f"{method}: {printed.err}"
    assert working == re.findall(r"`(\w+)`", methods)
    scored = PROGRAM.run(["eval", home])
    printed = capsys.readouterr()
    if truth == "-":
        assert scored == 1 and "error: " in printed.err
    else:
        assert scored == 0 and "1 frame," in printed.out
