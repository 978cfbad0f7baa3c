"""Write a street as a KITTI raw drive, frame by frame, going on where a stopped run left off.

OUT/street/calib_{cam_to_cam,velo_to_cam,imu_to_velo}.txt
OUT/street/street_0007_sync/image_02|03/{data/*.png,timestamps.txt}    the pair
                           /velodyne_points, oxts                      as KITTI's; the sweeps are not untwisted
                           /sky/image_02|03/data/*.png                 255 = the pixel's centre sees sky
                           /proj_depth/groundtruth/image_02|03         exact depth of every pixel nearer than 256 m
                           /proj_depth/velodyne_raw/image_02|03        the frame's own sweep, untwisted and projected
                           /street.json                                what was asked for
"""

import json
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from priors import codecs, geometry
from priors.errors import DataError
from priors.street import kitti, rig
from priors.street.config import StreetConfig
from priors.street.corner import with_corner
from priors.street.street import FRAME_S, Street
from priors.types import FloatMap, Matrix

Floats = npt.NDArray[np.floating]
DATE = "street"
STREET_VERSION = 2
"""Counts changes of what a seed looks like: a drive begun by another version is not continued."""
VISIBLE_M = 330.0
PAIR_CAMERAS = ("image_02", "image_03")
Corner: TypeAlias = Literal["none", "left", "right"]
TURNS: Mapping[str, int] = {"left": 1, "right": -1}


@dataclass(frozen=True)
class Asked:
    """Which drive through which street."""

    frames: int
    """How many, at 10 Hz."""
    seed: int
    """Which street: the same seed, size, corner and number of frames give the same bytes."""
    size: tuple[int, int] = (375, 1242)
    """(height, width) of the images, pixels."""
    corner: Corner = "none"
    """Where the street turns by 90 degrees, and the drive with it."""

    def __post_init__(self) -> None:
        if self.frames < 1 or min(self.size) < 16:
            height, width = self.size
            raise DataError(f"street: {self.frames} frames of {width}x{height}: expected at least 1 frame of 16x16")

    @property
    def name(self) -> str:
        """The drive's folder."""
        return f"street_{self.seed:04d}{'' if self.corner == 'none' else f'_{self.corner}'}_sync"

    def record(self) -> dict[str, object]:
        """Return what street.json says."""
        around = {} if self.corner == "none" else {"corner": self.corner}
        return {"version": STREET_VERSION, "seed": self.seed, "frames": self.frames, "size": list(self.size), **around}

    def street(self) -> Street:
        """Build the street, as long as the drive sees."""
        config = self._config(StreetConfig.draw(self.seed))
        length_m = VISIBLE_M + 1.1 * self.frames * FRAME_S * config.speed_mps
        return Street(self.seed, config=self._config(StreetConfig.draw(self.seed, length_m)))

    def _config(self, drawn: StreetConfig) -> StreetConfig:
        return drawn if self.corner == "none" else with_corner(drawn, TURNS[self.corner])


def write_street(
    out: Path,
    frames: int,
    seed: int,
    size: tuple[int, int] = (375, 1242),
    on_frame: Callable[[int], None] | None = None,
    workers: int = 1,
) -> Path:
    """Write `frames` frames of the street of a seed in the KITTI raw layout; see write_drive."""
    return write_drive(out, Asked(frames, seed, size), on_frame, workers)


def write_drive(out: Path, asked: Asked, on_frame: Callable[[int], None] | None = None, workers: int = 1) -> Path:
    """Write a drive through a street in the KITTI raw layout; frames already there are kept.

    Args:
        out: folder to write into.
        asked: which drive.
        on_frame: called with a frame's number when it is written or found written.
        workers: threads.

    Returns:
        the drive's folder.

    Raises:
        DataError: the folder holds another street.
    """
    drive = Path(out) / DATE / asked.name
    _claim(drive, asked.record())
    todo = [number for number in range(asked.frames) if not _marker(drive, number).exists()]
    for number in sorted(set(range(asked.frames)) - set(todo)):
        _tell(on_frame, number)
    if not todo:
        return drive
    street = asked.street()
    kitti.write_calibration(drive.parent, rig.camera(asked.size))
    _write_way(drive, street, asked.frames)
    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        running = {}
        rest = iter(todo)
        while True:
            for number in rest:
                running[pool.submit(_write_frame, drive, street, number, asked.size)] = number
                if len(running) > workers:
                    break
            if not running:
                return drive
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                done.result()
                _tell(on_frame, running.pop(done))


def _tell(on_frame: Callable[[int], None] | None, number: int) -> None:
    if on_frame is not None:
        on_frame(number)


def _claim(drive: Path, wanted: dict[str, object]) -> None:
    """Record what the drive is, or make sure that it is the same."""
    path = drive / "street.json"
    if path.exists():
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            record = None
        if record != wanted:
            raise DataError(f"{path}: holds another street ({record}, not {wanted}): remove it or choose another OUT")
    else:
        write_bytes(path, (json.dumps(wanted) + "\n").encode())


def _marker(drive: Path, number: int) -> Path:
    """Return the file that is written last of a frame."""
    return drive / "velodyne_points" / "data" / f"{number:010d}.bin"


def _write_way(drive: Path, street: Street, frames: int) -> None:
    """Write poses and times."""
    times = FRAME_S * np.arange(frames)
    T_world_imu = street.T_world_velo(times) @ rig.T_velo_imu()
    for number, line in enumerate(kitti.oxts_lines(T_world_imu, street.config.speed_mps)):
        write_bytes(drive / "oxts" / "data" / f"{number:010d}.txt", line.encode())
    stamps = kitti.timestamps(times).encode()
    for folder in (*PAIR_CAMERAS, "velodyne_points", "oxts"):
        write_bytes(drive / folder / "timestamps.txt", stamps)


def _write_frame(drive: Path, street: Street, number: int, size: tuple[int, int]) -> None:
    """Write everything of one frame, the sweep last: it marks the frame as done."""
    time_s = FRAME_S * number
    camera, id_ = rig.camera(size), f"{number:010d}"
    points, seconds = street.sweep(time_s, number)
    T_world_left = street.T_world_cam(time_s)
    poses = {"image_02": T_world_left, "image_03": rig.right_of(T_world_left)}
    for eye, (name, T_world_cam) in enumerate(poses.items()):
        view = street.view(T_world_cam, camera, time_s, 2 * number + eye)
        maps = drive / "proj_depth"
        codecs.write_image(drive / name / "data" / f"{id_}.png", view.image)
        codecs.write_image(drive / "sky" / name / "data" / f"{id_}.png", view.sky.astype(np.uint8) * 255)
        codecs.write_depth_png(maps / "groundtruth" / name / f"{id_}.png", view.depth_m)
        sparse = _project(street, points[:, :3], seconds, time_s, T_world_cam, size)
        codecs.write_depth_png(maps / "velodyne_raw" / name / f"{id_}.png", sparse)
    write_bytes(_marker(drive, number), points.astype("<f4").tobytes())


def _project(
    street: Street, xyz_m: Floats, seconds: Floats, time_s: float, T_world_cam: Matrix, size: tuple[int, int]
) -> FloatMap:
    """Put a sweep into a camera's image, every point moved by the rig's true motion since its own moment."""
    turns, which = np.unique(seconds, return_inverse=True)
    T_cam_velo = (geometry.invert(T_world_cam) @ street.T_world_velo(time_s + turns)).astype(np.float32)
    xyz_cam = np.einsum("nij,nj->ni", T_cam_velo[which, :3, :3], xyz_m) + T_cam_velo[which, :3, 3]
    ahead = xyz_cam[xyz_cam[:, 2] > 0.5]
    return geometry.scatter_nearest(*geometry.project(rig.camera(size), ahead), size)
