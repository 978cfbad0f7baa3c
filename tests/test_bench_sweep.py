"""How time and memory grow: slopes of known laws, the points of each axis, and a drive at other sizes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_folder

from priors.bench import sweep as sweeps
from priors.bench.entrants import Entrant
from priors.bench.fewer_lines import FewerLines, line_of, thin
from priors.bench.scout import Errand, Scouted, run
from priors.bench.sweep import Growth, Measured, lay_out, plots, points
from priors.draw.lines import draw
from priors.drives import open_drive
from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.resized import Resized
from priors.types import Method, Sweep

pytestmark = pytest.mark.stress
STEREO = Entrant("stereo", Stereo(offset_px=(0.0,)))


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_a_slope_is_the_power_of_the_law(power: float) -> None:
    made = [Measured(x, Scouted(processor_s=3 * x**power, peak_gib=1.0)) for x in (10.0, 20.0, 40.0, 80.0)]
    growth = Growth("any", tuple(made))
    assert growth.slope(lambda told: told.processor_s) == pytest.approx(power, abs=1e-9)
    assert growth.slope(lambda told: told.peak_gib) == pytest.approx(0, abs=1e-9)
    assert math.isnan(Growth("any", tuple(made[:2])).slope(lambda told: told.processor_s))


def test_the_axes_have_their_own_work() -> None:
    sizes = points("size", [STEREO], (100, 200))
    assert [(x, share) for x, share, _, _ in sizes][-1] == (20_000, 1.0) and len(sizes) == len(sweeps.SHARES)
    searched = points("disparity", [], (100, 100))
    assert {x for x, *_ in searched} == {32, 64, 96}  # an image of 100 columns has no more
    assert {name for _, _, name, _ in searched} == {"stereo", "stereo cfnet-s"}
    assert [x for x, *_ in points("sweeps", [], (100, 100))] == list(sweeps.SWEEPS)
    lines = points("lines", [], (100, 100))
    assert [x for x, _, name, _ in lines if name == "lidar"] == [8, 16, 32, 64]
    assert {name for _, _, name, _ in lines} == {"lidar", "completion"}


def test_fewer_lines_are_every_nth() -> None:
    """A scanner of 64 lines that sees a cylinder: each line is a ring of points."""
    elevation, azimuth = np.meshgrid(np.radians(np.linspace(2, -24, 64)), np.linspace(0, 2, 50), indexing="ij")
    xyz_m = 20 * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    sweep = Sweep(xyz_m.astype(np.float32), None, np.arange(len(xyz_m), dtype=np.float32))
    assert np.abs(line_of(sweep.xyz_m) - np.repeat(np.arange(64), 50)).max() <= 1
    half = thin(sweep, 2)
    assert half.time_s is not None and len(half.time_s) == len(half.xyz_m)
    assert 0.4 < len(half.xyz_m) / len(xyz_m) < 0.6
    assert len(thin(Sweep(np.zeros((0, 3), np.float32), None), 4).xyz_m) == 0


def test_a_thinner_drive_keeps_images(street: Path) -> None:
    drive = open_drive(street)
    frame, whole = FewerLines(drive, 4)[1], drive[1]
    assert not frame.has("sparse") and np.array_equal(frame.image(), whole.image())
    few, all_ = frame.sweep(), whole.sweep()
    assert few is not None and all_ is not None and 0.1 < len(few.xyz_m) / len(all_.xyz_m) < 0.4


def test_a_smaller_drive_sees_the_same_scene(tmp_path: Path) -> None:
    drive = open_drive(write_folder(tmp_path))
    small = Resized(drive, 0.5)
    frame = small[0]
    assert frame.image().shape[:2] == frame.other().shape[:2] == frame.camera.size == (48, 120)
    assert not frame.has("truth") and small.ids == drive.ids and len(small) == len(drive)
    made = Stereo(offset_px=(0.0,))
    full_m, half_m = made(drive[0]).depth_m, made(frame).depth_m
    assert np.median(np.abs(full_m[::2, ::2] / half_m - 1)) < 0.05


def test_a_scout_works_at_another_size(tmp_path: Path) -> None:
    drive = open_drive(write_folder(tmp_path))
    found = run(Errand(STEREO.method, {"name": drive.name, **drive.describe()}, 0, 1, 0.5))
    assert not found.error and found.processor_s > 0 and found.peak_gib > 0


def test_what_cannot_be_measured_is_told_beside_the_others(tmp_path: Path) -> None:
    drive = open_drive(write_folder(tmp_path))

    def scout(method: Method, drive: Any, frame: int, timeout_s: float | None, share: float, every: int) -> Scouted:
        return Scouted(error="no LiDAR") if method == Lidar() else Scouted(0, 0, share**2, 0.5)

    names: list[str] = []
    grown = sweeps.sweep("size", [STEREO, Entrant("lidar", Lidar())], drive, 0, names.append, scout)
    assert names[:2] == ["stereo", "lidar"]  # in turn
    laid = lay_out("pixels", grown, "a drive")
    assert laid.cells[0][0] == "1.00" and laid.cells[1] == ["-"] * 5 and laid.notes == ["lidar: no LiDAR"]
    drawn = draw(plots("pixels", grown), 2).axes[0]
    assert drawn.get_xscale() == drawn.get_yscale() == "log" and len(drawn.lines) == 1
    with pytest.raises(DataError, match="--sweep size: no LiDAR"):
        sweeps.sweep("size", [Entrant("lidar", Lidar())], drive, 0, scout=scout)
