"""The pack: a plain folder with all that the other machine needs and the checkout does not hold.

gpu-pack/drive/<date>/calib_*.txt, <drive>/image_02, oxts   the left eye of a KITTI raw drive
        /prior/<drive>/stereo-<key>                         its stereo prior, from `priors build`
        /truth/<id>.png                                     a held-out view's own LiDAR sweep, metres x 256
        /pack.json                                          what it was made of; written last
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eval.files import write_bytes
from priors import cache, codecs
from priors.drives import open_drive
from priors.drives._files import follow
from priors.methods.lidar import Lidar
from priors.types import Drive

if TYPE_CHECKING:
    from nerf.scene import Scene

LARGEST_BYTES = 35 << 20
"""A pack may not be larger: it travels with every call."""


def make_pack(data: Path, pack: Path) -> int:
    """Make a pack of the one KITTI raw drive under `data`; returns 1 where that is not possible."""
    if (pack / "pack.json").exists():
        print(f"{pack}: made already; delete the folder to make it anew")
        return 0
    if not data.is_dir():
        print(f"{data}: no such folder: name the 397x120 drive with --data")
        return 1
    drive = open_drive(data)
    if drive.describe()["dataset"] != "kitti_raw":
        print(f"{data}: expected a KITTI raw drive, found {drive.describe()['dataset']}")
        return 1
    shutil.rmtree(pack, ignore_errors=True)
    _copy_drive(Path(drive.describe()["path"]), pack / "drive")
    _build_prior(data, pack)
    _write_truth(drive, pack)
    size = sum(path.stat().st_size for path in pack.rglob("*") if path.is_file())
    write_bytes(pack / "pack.json", json.dumps({"drive": drive.name, "bytes": size}).encode())
    print(f"{pack}: {drive.name}, {len(drive)} frames, {size / 2**20:.1f} MiB")
    if size > LARGEST_BYTES:
        print(f"{pack}: larger than the {LARGEST_BYTES >> 20} MiB that may travel: take a smaller drive")
        return 1
    return 0


def open_pack(pack: Path, scenes: Path) -> "Scene":
    """Open the packed drive with its prior as a scene, sparse views; its arrays go into the folder `scenes`."""
    from nerf.prepare import SceneConfig, open_scene

    if not (pack / "pack.json").exists():
        raise SystemExit(f"{pack}: no pack here: make it where the data is (make gpu, or --make-pack)")
    drive = open_drive(pack / "drive")
    return open_scene(drive, cache.only(pack / "prior"), SceneConfig("sparse"), scenes)


def truth_path(pack: Path, frame_id: str) -> Path:
    """Return where a held-out view's true depth is."""
    return pack / "truth" / f"{frame_id}.png"


def _copy_drive(folder: Path, place: Path) -> None:
    """Copy calibration, left eye and poses; links are followed, and the LiDAR stays behind."""
    date = place / folder.parent.name
    for path in folder.parent.glob("calib_*.txt"):
        date.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, date)
    for part in ("image_02", "oxts"):
        shutil.copytree(follow(folder / part), date / folder.name / part)


def _build_prior(data: Path, pack: Path) -> None:
    """Let the product build the stereo prior; the drive's fingerprint does not depend on where it lies."""
    command = [str(Path(sys.executable).with_name("priors")), "build", str(data), "--method", "stereo"]
    subprocess.run([*command, "--cache", str(pack / "prior")], check=True)


def _write_truth(drive: Drive, pack: Path) -> None:
    """Project each held-out view's own sweep."""
    from nerf.split import split

    for position in split(len(drive), "sparse")[1]:
        frame = drive[position]
        codecs.write_depth_png(truth_path(pack, frame.id), Lidar(sweeps=1).resolve(frame)(frame).depth_m)
