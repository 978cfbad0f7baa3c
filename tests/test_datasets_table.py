"""The table of docs/datasets.md: what each data set can be built and scored by. Each cell is a command, run here."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from factories import (
    T_CAM0_VELO,
    depth_m,
    scene,
    scene_points,
    write_argoverse_stereo,
    write_argoverse_tracking,
    write_bin,
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
from priors import cache, codecs, drives
from priors.geometry import invert, transform

pytestmark = pytest.mark.datasets
PAGE = Path(__file__).resolve().parents[1] / "docs" / "datasets.md"
METHODS = ("lidar", "completion", "stereo", "mono")
FORMATS = ("nerfstudio", "colmap", "3dgs", "ply")
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
    calibration = json.loads((own / "calib.json").read_text()) | {"T_cam_lidar": T_CAM0_VELO[:3].tolist()}
    (own / "calib.json").write_text(json.dumps(calibration))
    for id_ in ("a", "b", "c"):
        write_bin(own / "lidar" / f"{id_}.bin", transform(invert(T_CAM0_VELO), scene_points()))
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
TEST_IMAGES: dict[str, Callable[[Path], Path]] = {
    "kitti_stereo": write_2015,
    "kitti_depth": lambda root: write_selection(root, "test_depth_completion_anonymous"),
}
"""Data set -> writes images that are called as those of its benchmark's test: `--to kitti` is for them."""


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
    methods, truth, formats, *_ = rows()[name]
    named, home = WRITERS[name](tmp_path / "data"), tmp_path / "cache"
    code = PROGRAM.run(["check", *named])
    assert code == (1 if name == "argoverse1" else 0), capsys.readouterr().out  # whose images are blank here: told
    working = []
    for method in METHODS:
        flags = ["--stereo.offset-px", "0"] if method == "stereo" else []
        code = PROGRAM.run(["build", *named, "--method", method, "--cache", str(home), "--shard", "1/100", *flags])
        printed = capsys.readouterr()
        if code == 0:
            working.append(method)
        else:
            assert "error: no frame can be computed: " in printed.err, f"{method}: {printed.err}"
    assert working == words(methods)
    scored = PROGRAM.run(["eval", str(home)])
    printed = capsys.readouterr()
    if truth == "-":
        assert scored == 1 and "error: " in printed.err
    else:
        assert scored == 0 and "1 frame," in printed.out
    (prior,) = home.glob("*/mono-*")
    written = [to for to in FORMATS if exports(prior, to, tmp_path / "out", capsys)]
    if name in TEST_IMAGES:
        data, home = TEST_IMAGES[name](tmp_path / "test"), tmp_path / "cache-test"
        assert PROGRAM.run(["build", str(data), "--method", "mono", "--cache", str(home), "--shard", "1/100"]) == 0
        written += ["kitti"] if exports(next(home.glob("*/mono-*")), "kitti", tmp_path / "out", capsys) else []
    assert written == words(formats)
    imports(prior, named, tmp_path, capsys)


def words(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def exports(prior: Path, to: str, out: Path, capsys: pytest.CaptureFixture[str]) -> bool:
    """Export a prior to a format; where that is not possible, one line says why."""
    place = out / {"ply": "a.ply", "kitti": "a.zip"}.get(to, to)
    code = PROGRAM.run(["export", str(prior), "--to", to, "--out", str(place)])
    printed = capsys.readouterr()
    if code == 0 and place.exists():
        return True
    assert printed.err.startswith("error: ") and printed.err.count("error") == 1, f"{to}: {printed.err}"
    return False


def imports(prior: Path, named: list[str], work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Import maps of another program: all is 7 m away. They may be of images that bend lines, as these then are."""
    (work / "maps").mkdir()
    for id_ in cache.load(prior).ids():
        np.save(work / "maps" / f"{id_}.npy", np.full_like(cache.load(prior).read(id_).depth_m, 7.0))
    flags = ["--depth", str(work / "maps"), "--cache", str(work / "imported"), "--unchecked"]
    assert PROGRAM.run(["import", *named, *flags]) == 0, capsys.readouterr().err
    (theirs,) = (work / "imported").glob("*/imported-*")
    for id_ in cache.load(prior).ids():
        found_m = cache.load(theirs).read(id_).depth_m
        assert (found_m == 7).mean() > 0.95 and set(np.unique(found_m)) <= {0, 7}
