"""Sweeps that are none, and values in them that are no metres."""

from pathlib import Path

import numpy as np
import pytest
from factories import write_ply

from priors.drives._ply import read_ply
from priors.drives._velodyne import read_sweep_file
from priors.errors import DataError

RNG = np.random.default_rng(0)
POINTS = np.hstack([RNG.uniform(-60, 60, (500, 3)), RNG.uniform(0, 1, (500, 1))]).astype("<f4")


def written(path: Path, table: np.ndarray) -> Path:
    table.tofile(path)
    return path


@pytest.mark.parametrize(
    "table",
    [
        POINTS.astype(">f4"),
        POINTS.round(1).astype(">f4"),
        POINTS.astype("<f8"),
        POINTS[:, :3][:500],  # no reflectance
        np.hstack([POINTS, POINTS[:, :1]])[:500],  # a fifth column
        (POINTS * 1e6).astype("<f4"),
        np.frombuffer(b"0.125 -7.5 3.25 0.5\n" * 40, np.uint8),
        np.frombuffer(b"\x89PNG\r\n\x1a\n" + bytes(8) + RNG.bytes(1600), np.uint8),
        np.zeros(160, np.uint8),
        np.full((40, 4), np.nan, "<f4"),
    ],
    ids=["big", "big, round", "double", "three", "five", "micrometres", "text", "png", "zeros", "nan"],
)
def test_what_is_no_sweep_is_told_in_one_line(tmp_path: Path, table: np.ndarray) -> None:
    path = written(tmp_path / "0.bin", table)
    with pytest.raises(DataError, match=r"0\.bin: ") as caught:
        read_sweep_file(path)
    assert "\n" not in str(caught.value)


def test_another_format_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "0.npy", POINTS)
    with pytest.raises(DataError, match="is a NumPy file: expected little-endian float32"):
        read_sweep_file((tmp_path / "0.npy").rename(tmp_path / "0.bin"))


def test_places_without_an_echo_do_not_speak_against_a_sweep(tmp_path: Path) -> None:
    table = np.vstack([POINTS, np.zeros((900, 4), "<f4"), np.full((900, 4), np.nan, "<f4")])
    table[:3, 0] = 1e30, 1e-38, np.inf
    np.testing.assert_array_equal(read_sweep_file(written(tmp_path / "0.bin", table)), POINTS[3:, :3])


def test_one_unknown_reflectance_for_all_is_as_good(tmp_path: Path) -> None:
    table = POINTS.copy()
    table[:, 3] = -1
    np.testing.assert_array_equal(read_sweep_file(written(tmp_path / "0.bin", table)), POINTS[:, :3])


def test_sound_sweeps_stay_as_they_are(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read_sweep_file(written(tmp_path / "0.bin", POINTS)), POINTS[:, :3])


def test_ply_sweeps_are_held_to_the_same(tmp_path: Path) -> None:
    xyz = POINTS[:, :3].copy()
    xyz[0] = 1e30
    write_ply(tmp_path / "0.ply", xyz)
    np.testing.assert_array_equal(read_ply(tmp_path / "0.ply"), xyz[1:])
    write_ply(tmp_path / "0.ply", xyz * np.float32(1e6))
    with pytest.raises(DataError, match="are metres: expected x y z in metres"):
        read_ply(tmp_path / "0.ply")
